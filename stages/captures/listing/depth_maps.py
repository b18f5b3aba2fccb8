"""Depth maps that lie beside the pictures of a capture, found by their names."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Sequence
from pathlib import Path

from ....vision.depth.files import GREY, IMAGES, SUFFIXES, missing_extra
from ....vision.images.files import BadImageError, open_image
from .. import checks
from ..reading import Shot

FOLDERS = ("depth", "depths")
CONFIDENCE = ("confidence", "conf")
SHAPE = 0.05  # share by which the ratio of the sides may differ from that of the picture
NEAR = 0.03  # seconds; pictures and depth of a TUM recording whose time stamps differ by less belong together
_STAMP = re.compile(r"\d+\.\d+")


def add_depth(root: Path, shots: Sequence[Shot]) -> tuple[str, ...]:
    """Assigns to each shot without depth its map, if there is one: `depth/NAME` for `images/NAME`, or for NAME in the capture itself, with
    any of `SUFFIXES`; `depth/1x/NAME` for `rgb/1x/NAME`; `NAME.depth.png` beside `NAME.color.png`; the nearest stamp where names are time
    stamps; `NAME.depth` and `NAME.conf` beside it; and likewise `confidence/`. Maps that are no grey picture or do not have the shape of
    theirs are left out, and those that need a package that is not installed. Returns notes for people if there is any."""
    listed: dict[str, dict[str, str]] = {}
    for shot in shots:
        if shot.file is not None:
            shot.depth = shot.depth or _found(root, shot.file, FOLDERS, listed)
            shot.depth_confidence = _found(root, shot.file, CONFIDENCE, listed) if shot.depth else None
    needing = {shot.depth: extra for shot in shots if shot.depth and (extra := missing_extra(shot.depth))}
    for shot in shots:
        if shot.depth in needing:
            shot.depth = shot.depth_confidence = None
    unfit = [shot.depth for shot in shots if shot.depth and not _fits(root, shot)]
    for shot in shots:
        if shot.depth in unfit:
            shot.depth = shot.depth_confidence = None
    said = told(shots)
    if needing:
        first, extra = next(iter(needing.items()))
        said += (f"{len(needing)} depth maps are not read (first {first}): that needs pip install 'e4dgs[{extra}]'",)
    if unfit and (said or needing):
        said += (f"{len(unfit)} depth maps are no grey picture or do not have the shape of theirs, and are left out (first {unfit[0]})",)
    return said


def _fits(root: Path, shot: Shot) -> bool:
    """Whether the map of ``shot`` can be opened and has the shape of its picture; that of others is not known yet."""
    assert shot.depth is not None
    if not shot.depth.lower().endswith(IMAGES):
        return True
    try:
        with open_image(root / shot.depth) as opened:
            if opened.mode not in GREY:  # a picture of depth in colours
                return False
            width, height = opened.size
    except BadImageError:
        return False
    return abs(width * shot.size[1] / (height * shot.size[0]) - 1) < SHAPE


def told(shots: Sequence[Shot]) -> tuple[str, ...]:
    """A note about how many of ``shots`` have depth, for people; none if no shot has any."""
    deep = [shot for shot in shots if shot.depth]
    if not deep:
        return ()
    sure = sum(shot.depth_confidence is not None for shot in deep)
    return (
        f"{len(deep)} of {len(shots)} images have a depth map (first {deep[0].depth}){f', {sure} of them with confidence' if sure else ''}",
    )


def _found(root: Path, file: str, folders: Sequence[str], listed: dict[str, dict[str, str]]) -> str | None:
    """The file for picture ``file`` in one of ``folders`` beside it or beside its folder; None if there is none."""
    folder, name = posixpath.split(file)
    stem = posixpath.splitext(name)[0]
    bare = re.sub(r"\.(color|colour|rgb)$", "", stem, flags=re.IGNORECASE)
    if bare != stem:
        for suffix in SUFFIXES:
            beside = posixpath.join(folder, f"{bare}.{folders[0]}{suffix}")
            if (root / beside).is_file():
                return beside
    packed = posixpath.join(folder, f"{stem}.{folders[-1] if folders is CONFIDENCE else folders[0]}")
    if (root / packed).is_file():  # Record3D's
        return packed
    inside = folder.partition("/")[2]
    for other in folders:
        places = (posixpath.dirname(folder), other), (folder, other), (other, inside)
        for where in dict.fromkeys(posixpath.join(*place).rstrip("/") for place in places):
            there = _listed(root, where, listed) if where != folder else {}
            match = there.get(stem) or _at_stamp(stem, there)
            if match:
                return posixpath.join(where, match)
    return None


def _listed(root: Path, folder: str, listed: dict[str, dict[str, str]]) -> dict[str, str]:
    """The files of ``folder`` that may be maps, by their names without suffixes; empty if it does not exist."""
    if folder not in listed:
        names = checks.list_folder(root / folder) if (root / folder).is_dir() else []
        listed[folder] = {posixpath.splitext(n)[0]: n for n in names if n.lower().endswith(SUFFIXES) and (root / folder / n).is_file()}
    return listed[folder]


def _at_stamp(stem: str, there: dict[str, str]) -> str | None:
    """The file whose name is the time stamp nearest to ``stem``, if both are stamps in seconds with a fraction."""
    if not _STAMP.fullmatch(stem):
        return None
    nearest = min((s for s in there if _STAMP.fullmatch(s)), key=lambda s: abs(float(s) - float(stem)), default=None)
    return there[nearest] if nearest is not None and abs(float(nearest) - float(stem)) < NEAR else None
