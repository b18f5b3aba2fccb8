"""The lines about several videos."""

from __future__ import annotations

from collections.abc import Mapping

from .survey import Survey


def told_together(surveys: Mapping[str, Survey]) -> tuple[str, ...]:
    """The lines of several videos; one line for those that share it."""
    names: dict[str, list[str]] = {}
    for name, found in surveys.items():
        for note in found.notes:
            names.setdefault(note, []).append(name)
    return tuple(f"{_listed(those)}: {note}" for note, those in names.items())


def _listed(names: list[str]) -> str:
    return ", ".join(names) if len(names) < 4 else f"{names[0]}, {names[1]} and {len(names) - 2} more"
