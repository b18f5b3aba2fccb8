"""Files that a file manager or a download made twice: they would count as further cameras, or as further times."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Sequence
from filecmp import cmp
from pathlib import Path

# `Copy of a.jpg`; and `a (1).jpg`, `a 2.jpg`, `a - Kopie (3).jpg`, `a_copy.jpg`, `a.sync-conflict-20240101.jpg`: what follows the name of
# the other one is in any language
_BEFORE = re.compile(r"(?:copy of|kopie von|copie de|copia de|kopia) (.+)", re.IGNORECASE)
_AFTER = re.compile(r"[ .(-]|_(?=copy)", re.IGNORECASE)
# edited pictures and clips: of an iPhone `IMG_E0007.JPG`, of Google Photos `a-edited.jpg` and `a~2.jpg`, of Lightroom `a-Edit.jpg` and
# `a-Enhanced-NR.jpg`, of DxO `a_DxO.jpg`; and portraits of a Pixel, whose background is blurred
_EDITED = re.compile(r"(img_)e(\d{4,5})|(.+)(?:-edit(?:ed)?(?:-\d)?|-enhanced(?:-\w+)*|[-_]dxo.*|~\d)|(.+-)01\.cover", re.IGNORECASE)


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
        match = _BEFORE.fullmatch(stem)
        originals = [match[1]] if match else [stem[: at.start()].rstrip(" -") for at in _AFTER.finditer(stem)]
        others = (by_name.get(posixpath.join(folder, f"{original}{suffix}").lower()) for original in originals)
        if (other := next((o for o in others if o not in (None, name)), None)) is not None and _same(root / name, root / other):
            found[name] = other
    return found


def edited(names: Sequence[str]) -> dict[str, str]:
    """Those of `names`, pictures or videos, whose name says that they are an edited version of another one beside them, and that one. They
    may be cropped, turned or shortened, so that the other one is sure to be what the camera saw."""
    by_stem = {posixpath.splitext(name)[0].lower(): name for name in names}
    found = {}
    for name in names:
        folder, file = posixpath.split(name)
        match = _EDITED.fullmatch(posixpath.splitext(file)[0])
        if match is not None:
            original = by_stem.get(
                posixpath.join(folder, f"{match[4]}02.original" if match[4] else match[3] or match[1] + match[2]).lower()
            )
            if original is not None:
                found[name] = original
    return found


def told_edited(found: dict[str, str], many: str) -> tuple[str, ...]:
    """A line about edited versions that are left out. many: what they are."""
    if not found:
        return ()
    name, other = next(iter(found.items()))
    if len(found) == 1:
        return (f"{name} is left out: by its name it is an edited version of {other}, which is read",)
    return (
        f"{len(found)} {many} are left out: by their names they are edited versions of others, which are read (first {name}, of {other})",
    )


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
