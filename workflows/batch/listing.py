"""The scenes of a batch: captures from paths, patterns and YAML lists, with their settings, and sweeps over settings."""

from __future__ import annotations

import glob
import itertools
import math
import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from ...pipeline import SettingsError
from ...pipeline.files import digest_bytes
from ...pipeline.names import composed, fitted, only_safe, safe_name
from ..scenes import check_name
from ..session import Choice, Options
from .yaml_files import read_yaml

MOST_SCENES = 100_000


@dataclass(frozen=True)
class Entry:
    """One scene of a batch, in a form that fits JSON. capture: an absolute path. settings: ("stage.key", text) as after ``--set``. group:
    the same for scenes that differ only in their seeds."""

    name: str
    capture: str
    settings: tuple[tuple[str, str], ...] = ()
    preset: str = "default"
    static: bool = False
    format: str | None = None
    device: str = "auto"
    group: str = ""
    store_also: tuple[str, ...] = ()

    def options(self, workspace: Path) -> Options:
        choice = Choice(self.preset, tuple(f"{key}={value}" for key, value in self.settings), self.device, self.static, self.format)
        return Options(Path(self.capture), workspace, choice, self.name, [Path(path) for path in self.store_also])

    def as_json(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Entry:
        """Reads what `as_json` of this, an earlier or a later version wrote. Unknown fields are left out."""
        settings = tuple((key, value) for key, value in data.get("settings", ()))
        return cls(**{**known(cls, data), "settings": settings, "store_also": tuple(data.get("store_also", ()))})


def known(cls: type, data: Mapping[str, Any]) -> dict[str, Any]:
    """The items of ``data`` that are fields of the dataclass ``cls``."""
    return {f.name: data[f.name] for f in fields(cls) if f.name in data}


@dataclass
class _Listed:
    """Captures, and the sweep that applies to all of them."""

    entries: list[Entry] = field(default_factory=list)
    sweep: dict[str, list[str]] = field(default_factory=dict)


def entries_of(words: Sequence[str], common: Entry) -> list[Entry]:
    """The scenes that the ``words`` of a command line name: paths, patterns with *, ? or [] unless there is a file of just that name, and
    lists that end in .yaml or .yml. ``common`` holds what applies to all of them; a list's own settings win over it.

    Raises SettingsError if a word names nothing, a list is not valid, or two scenes have the same name.
    """
    listed = _Listed()
    for word in words:
        if not word.strip():
            raise SettingsError("CAPTURE: a name is empty; give one, or . for the current folder")
        if word.endswith((".yaml", ".yml")):
            _read_list(Path(word), common, listed)
        else:
            listed.entries += [_entry(path, common) for path in _paths(word)]
    count = len(listed.entries) * math.prod(len(values) for values in listed.sweep.values())
    if count > MOST_SCENES:
        raise SettingsError(f"{count} scenes: a batch has at most {MOST_SCENES}")
    entries = _swept(_named(listed.entries), listed.sweep)
    twice = [name for name, count in Counter(entry.name for entry in entries).items() if count > 1]
    if twice:
        raise SettingsError(f"two scenes of this batch are called {twice[0]}; give them names of their own in a YAML list")
    return entries


def _paths(word: str) -> list[str]:
    if "\0" in word:
        raise SettingsError(f"{word!r}: not a file name")
    path = os.path.expanduser(word)
    is_pattern = any(c in word for c in "*?[") and not os.path.lexists(path)  # names of files may have brackets, too
    found = sorted(glob.glob(path)) if is_pattern else [path]
    if not found:
        raise SettingsError(f"{word}: no file or folder has such a name")
    return [os.path.abspath(path) for path in found]


def _entry(path: str, common: Entry) -> Entry:
    return replace(common, name="", capture=path)


def _read_list(file: Path, common: Entry, listed: _Listed) -> None:
    try:
        data = read_yaml(file)
    except (OSError, ValueError) as error:
        raise SettingsError(f"{file}: this is not a list of scenes in YAML ({error})") from error
    if isinstance(data, list):
        data = {"scenes": data}
    if not isinstance(data, dict) or not isinstance(data.get("scenes"), list):
        raise SettingsError(f"{file}: expected a list of captures, or a mapping with a list called scenes")
    _known(data, {"scenes", "settings", "preset", "sweep"}, str(file))
    common = _with(common, data, str(file))
    for k, row in enumerate(data["scenes"]):
        where = f"{file}: scene {k + 1}"
        row = {"capture": row} if isinstance(row, str) else row
        if not isinstance(row, dict) or not isinstance(row.get("capture"), str) or not row["capture"].strip():
            raise SettingsError(f"{where}: expected a path, or a mapping with capture")
        _known(row, {"capture", "name", "settings", "preset", "static", "format"}, where)
        word = os.path.expanduser(row["capture"])
        paths = _paths(word if os.path.isabs(word) else str(file.parent / word))
        name = composed(str(row.get("name", "")))
        if "name" in row:
            check_name(name, f"{where}: name")
        if "name" in row and len(paths) > 1:
            raise SettingsError(f"{where}: {len(paths)} captures cannot share the name {name}")
        listed.entries += [replace(_with(common, row, where), name=name, capture=path) for path in paths]
    sweep = data.get("sweep") or {}
    if not isinstance(sweep, dict) or not all(isinstance(values, list) and values for values in sweep.values()):
        raise SettingsError(f"{file}: sweep: expected a list of values for each setting")
    listed.sweep |= {str(key): [_text(value) for value in values] for key, values in sweep.items()}


def _known(data: Mapping[str, Any], fields: set[str], where: str) -> None:
    unknown = sorted(set(map(str, data)) - fields)
    if unknown:
        raise SettingsError(f"{where}: unknown field {unknown[0]}; fields: {', '.join(sorted(fields))}")


def _with(entry: Entry, data: Mapping[str, Any], where: str) -> Entry:
    settings = data.get("settings") or {}
    if not isinstance(settings, dict):
        raise SettingsError(f"{where}: settings: expected stage.key: value")
    merged = {**dict(entry.settings), **{str(key): _text(value) for key, value in settings.items()}}
    preset, static = str(data.get("preset", entry.preset)), bool(data.get("static", entry.static))
    return replace(entry, settings=tuple(merged.items()), preset=preset, static=static, format=data.get("format", entry.format))


def _text(value: Any) -> str:
    """The value as text for ``--set``."""
    if isinstance(value, list):
        return ",".join(map(_text, value))
    return str(value).lower() if isinstance(value, bool) else str(value)


def _named(entries: list[Entry]) -> list[Entry]:
    """Names scenes without a name after their capture. If several would have the same name, the name of its folder is put before each, and
    if that is the same, too, six digits of its path behind."""
    names = [entry.name or _safe(Path(entry.capture)) for entry in entries]
    for distinct in (_after_its_folder, _with_digits):
        often = Counter(names)
        own = zip(entries, names)
        names = [name if entry.name or often[name] == 1 else distinct(Path(entry.capture), name) for entry, name in own]
    return [replace(entry, name=name, group=name) for entry, name in zip(entries, map(fitted, names))]


def _after_its_folder(path: Path, name: str) -> str:
    return f"{_safe(path.parent)}-{name}"


def _with_digits(path: Path, name: str) -> str:
    return f"{name}-{digest_bytes(str(path).encode(errors='surrogateescape'))[:6]}"


def _safe(path: Path) -> str:
    stem = path.stem if path.suffix and not path.is_dir() else path.name
    return safe_name(stem, 60) or "capture"


def _swept(entries: list[Entry], sweep: Mapping[str, Sequence[str]]) -> list[Entry]:
    if not sweep:
        return entries
    result = []
    for entry in entries:
        for values in itertools.product(*sweep.values()):
            chosen = dict(zip(sweep, values))
            tail = ["-".join((key.rsplit(".", 1)[-1], re.sub("[_-]+", "-", only_safe(value)))) for key, value in chosen.items()]
            same = [f"{key}={value}" for key, value in chosen.items() if not key.endswith(".seed")]
            settings = tuple({**dict(entry.settings), **chosen}.items())
            result.append(
                replace(entry, name=fitted("-".join([entry.name, *tail])), settings=settings, group=" ".join([entry.group, *same]))
            )
    return result
