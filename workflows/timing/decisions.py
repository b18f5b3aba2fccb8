"""The settings that a time has decided: which the user chose, which an earlier run decided, which this one may decide."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...pipeline import build_settings, settings_by_name
from ..session import Session, assigned


class Decisions:
    """Of one run. session: where the decided settings are kept."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self._mine: set[str] = set()
        classes = session.job.graph.settings
        self._stages = {name: stages[0] for name, (stages, _) in settings_by_name(classes).items()}
        self._given = build_settings(classes, assigned(session.options.choice.set))  # also where an older spelling was used

    def given(self, name: str) -> bool:
        """Whether the user chose this setting."""
        return name.partition(".")[2] in self._given[self._stages[name]].model_fields_set

    def made_earlier(self, *names: str) -> bool:
        """Whether an earlier run with this time decided one of these settings. Its decisions stay, or results would not be found again."""
        resolved = {text.partition("=")[0] for text in self.session.options.choice.resolved}
        return bool((resolved & set(names)) - self._mine)

    def mine(self, *names: str) -> bool:
        """Whether this run has decided one of these settings; without names, whether it has decided anything."""
        return bool(self._mine & set(names)) if names else bool(self._mine)

    def value(self, name: str) -> Any:
        """The present value of a setting."""
        return getattr(self.session.job.settings[self._stages[name]], name.partition(".")[2])

    def make(self, values: Mapping[str, Any]) -> None:
        """Decides settings, except those that the user chose."""
        chosen = {name: value for name, value in values.items() if not self.given(name)}
        if chosen:
            self._mine |= chosen.keys()
            self.session.resolve(chosen)
