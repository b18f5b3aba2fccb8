"""Records of the last run of every stage for one scene: the key parts, so that a rerun can say what changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .files import read_json, write_json

SHOWN = 4  # at most this many changed source files are listed by name
SKIPPED = {"skipped": True}  # stands in place of a record
_ABSENT = "(absent)"  # stands for a field that only one version of a stage has


class Records:
    """One JSON file per stage in a scene's folder: ``{"key", "parts", "digest"}`` of the stage's last result. Of a stage that the last
    run skipped, only that is kept."""

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)

    def read(self, stage: str) -> dict[str, Any] | None:
        """The record of a stage's last result, or None if there is no valid record."""
        record = read_json(self.folder / f"{stage}.json")
        valid = isinstance(record, dict) and isinstance(record.get("key"), str) and isinstance(record.get("parts"), dict)
        return record if valid else None

    def write(self, stage: str, key: str, parts: Mapping[str, Any], digest: str) -> None:
        record = {"key": key, "parts": dict(parts), "digest": digest}
        if self.read(stage) != record:
            write_json(self.folder / f"{stage}.json", record)

    def skip(self, stage: str) -> None:
        """Replaces the record of a stage that the scene's last run skipped. Does nothing, also on a read-only disk, if there is none."""
        if self.read(stage) is not None:
            write_json(self.folder / f"{stage}.json", SKIPPED)

    def skipped(self, stage: str) -> bool:
        """Whether the scene's last run skipped this stage, which has run before."""
        return read_json(self.folder / f"{stage}.json") == SKIPPED


def differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """The key fields that differ, one line each: ``settings.iterations: 3000 -> 2000``."""
    lines = []
    for field in sorted({*old, *new}):
        before, after = old.get(field), new.get(field)
        if before == after:
            continue
        if field in ("settings", "inputs") and isinstance(before, Mapping) and isinstance(after, Mapping):
            for name in sorted({*before, *after}):
                if name not in before or name not in after or before[name] != after[name]:
                    lines.append(_line(field, name, before.get(name, _ABSENT), after.get(name, _ABSENT)))
        elif field == "code":
            lines += changed_files(before, after)
        elif field == "version":  # from older results, whose keys did not contain the code
            continue
        elif field == "capture":
            lines.append("the content of the capture's files changed")
        else:
            lines.append(f"{field}: {before} -> {after}")
    return lines


def changed_files(before: Mapping[str, Any] | None, after: Mapping[str, Any] | None) -> list[str]:
    """The source files that differ: ``scene/training/rates.py has changed``. A file that merely moved is not listed."""
    if before is None or after is None:
        return ["made by an earlier version, whose keys did not include the code"]
    if before["digest"] == after["digest"]:
        return []
    old, new = before["files"], after["files"]
    changed = [file for file in old if file in new and old[file] != new[file]]
    gone, added = [[file for file in one if file not in other] for one, other in ((old, new), (new, old))]
    for file in list(gone):
        if twin := next((other for other in added if new[other] == old[file]), None):
            gone.remove(file)
            added.remove(twin)
    found = (changed, "has", "have", "changed"), (added, "is", "are", "new"), (gone, "is", "are", "gone")
    lines = [f"{_listed(files)} {many if len(files) > 1 else one} {what}" for files, one, many, what in found if files]
    return lines or ["source files import one another differently"]


def _listed(files: Sequence[str]) -> str:
    """Lists at most `SHOWN` names and says how many more there are."""
    shown, more = list(files[:SHOWN]), len(files) - SHOWN
    if more > 0:
        return f"{', '.join(shown)} and {more} more"
    return " and ".join([", ".join(shown[:-1]), shown[-1]] if len(shown) > 1 else shown)


def _line(field: str, name: str, before: Any, after: Any) -> str:
    if field == "settings":
        return f"settings.{name}: {_short(before)} -> {_short(after)}"
    states = ["skipped" if value is None else "no input" if value == _ABSENT else "there" for value in (before, after)]
    if states != ["there", "there"]:
        return f"input {name}: {states[0]} -> {states[1]}"
    return f"input {name} changed"


def _short(value: Any) -> str:
    text = f"file {value['file'][:8]}" if isinstance(value, Mapping) and "file" in value else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
