"""Files that a file manager or a download made twice: they would count as further cameras, or as further times."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Sequence
from filecmp import cmp
from pathlib import Path

# `a (1).jpg`, `a copy 2.jpg`, `a - Copy (3).jpg`, `a_copy.jpg`, `Copy of a.jpg`
_COPY = re.compile(r"(.+?)(?: ?\(\d+\)|(?: ?- ?| |_)copy(?: ?\(?\d+\)?)?)|copy of (.+)", re.IGNORECASE)


def same_bytes(root: Path, names: Sequence[str]) -> dict[str, str]:
    """Those of `names`, relative to `root`, whose content is that of another one, and that one: of two, the shorter name stays."""
    kept: dict[int, list[str]] = {}
    found: dict[str, str] = {}
    for name in sorted(names, key=lambda name: (len(name), names.index(name))):
        alike = kept.setdefault(_size(root / name), [])
        other = next((other for other in alike if _same(root / name, root / other)), None)
        if other is None:
            alike.append(name)
        else:
            found[name] = other
    return found


def named_copies(root: Path, names: Sequence[str]) -> dict[str, str]:
    """As `same_bytes`, but only names that say that they are copies of the other one. Frames of a scene that stands still have the same
    bytes, too."""
    by_name = {name.lower(): name for name in names}
    found = {}
    for name in names:
        folder, file = posixpath.split(name)
        stem, suffix = posixpath.splitext(file)
        match = _COPY.fullmatch(stem)
        other = by_name.get(posixpath.join(folder, f"{match[1] or match[2]}{suffix}").lower()) if match else None
        if other is not None and other != name and _same(root / name, root / other):
            found[name] = other
    return found


def told(copies: dict[str, str], many: str) -> tuple[str, ...]:
    """A line about copies that are left out. many: what they are."""
    if not copies:
        return ()
    name, other = next(iter(copies.items()))
    if len(copies) == 1:
        return (f"{name} is left out: it is a copy of {other}, byte for byte",)
    return (f"{len(copies)} {many} are left out: each is a copy of another, byte for byte (first {name}, of {other})",)


def _size(file: Path) -> int:
    try:
        return file.stat().st_size
    except OSError:  # its reader says why
        return -1


def _same(file: Path, other: Path) -> bool:
    try:
        return cmp(file, other, shallow=False)
    except OSError:
        return False
