"""What is left of a run: the plan's estimates of the stages that follow, corrected by what the stages before have taken."""

from __future__ import annotations

from collections.abc import Sequence

from ...pipeline import Outcome, Row, duration

TRUSTED = 60.0  # s; the plan is believed as if it had been right for so long already, so that a short stage says little


class Left:
    """rows: the plan, of which stages without an estimate count as nothing."""

    def __init__(self, rows: Sequence[Row]) -> None:
        self._rows = rows
        self._taken = self._expected = TRUSTED

    def after(self, outcome: Outcome) -> str:
        """The end of a line about a stage that is done; empty if nothing that takes time follows."""
        names = [row.stage for row in self._rows]
        if outcome.stage not in names:
            return ""
        place = names.index(outcome.stage)
        if outcome.state == "ran" and self._rows[place].estimate is not None:
            self._taken += outcome.seconds
            self._expected += self._rows[place].estimate or 0.0
        seconds = sum(row.estimate or 0.0 for row in self._rows[place + 1 :] if row.state == "run")
        return f"; about {duration(seconds * self._taken / self._expected)} left" if seconds else ""
