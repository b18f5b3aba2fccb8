"""Runs a plan: the stages one after another, then what they leave for people and programs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from ..pipeline import Row, Runner, duration
from .reconstruction import EVALUATION, LIBRARIES
from .session import Session


def execute(
    session: Session,
    rows: Sequence[Row],
    console: Console,
    say: Callable[[str], None],
    targets: Sequence[str] | None = None,
    forced: Sequence[str] = (),
) -> tuple[Mapping[str, Any], Path] | None:
    """Run ``targets`` (None: all stages) and what they need. Returns metrics and the path of the report, None where none was made."""
    from .. import __version__
    from .publish import publish, write_plan

    def finished(outcome) -> None:
        session.scene.claim()  # only now: a capture that the first stage refuses leaves no scene behind
        write_plan(session, rows)
        if outcome.state == "ran":
            say(f"{outcome.stage}: done in {duration(outcome.seconds)}, at most {outcome.peak_rss_mb:.0f} MB")

    outcomes = Runner(session.job, say, console, __version__, LIBRARIES).run(targets, forced, finished)
    if outcomes[-1].stage != EVALUATION or outcomes[-1].artifact is None:
        return None
    return publish(session, rows, outcomes)
