"""Depth maps that lie beside the pictures of a capture, found by their names."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Sequence
from pathlib import Path

from ....vision.depth.files import GREY, IMAGES, SUFFIXES, missing_extra, stated_size
from ....vision.images.files import BadImageError, open_image
from .. import checks
from ..reading import Shot

FOLDERS = ("depth", "depths")
CONFIDENCE = ("confidence", "conf")
SHAPE = 0.05  # share by which the ratio of the sides may differ from that of the picture
NEAR = 0.03  # seconds; pictures and depth of a TUM recording whose time stamps differ by less belong together
_STAMP = re.compile(r"\d+\.\d+")


def add_depth(root: Path, shots: Sequence[Shot]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Assigns to each shot without depth its map, if there is one: `depth/NAME` for `images/NAME`, or for NAME in the capture itself, with
    any of `SUFFIXES`; `depth/1x/NAME` for `rgb/1x/NAME`; `NAME.depth.png` beside `NAME.color.png`; the nearest stamp where names are time
    stamps; `NAME.depth` and `NAME.conf` beside it; and likewise `confidence/`. Maps that are no grey picture or do not have the shape of
    their picture are left out, and those that need a package that is not installed. Returns notes for people if there is any, and the
    files that were left out."""
    listed: dict[str, dict[str, str]] = {}
    for shot in shots:
        if shot.file is not None:
            shot.depth = shot.depth or _found(root, shot.file, FOLDERS, listed)
            shot.depth_confidence = _found(root, shot.file, CONFIDENCE, listed) if shot.depth else None
    left_out: dict[str, list[str]] = {}
    files: list[str] = []
    for shot in shots:
        if shot.depth and (why := _unfit(root, shot)):
            left_out.setdefault(why, []).append(shot.depth)
            files += [shot.depth, *([shot.depth_confidence] if shot.depth_confidence else [])]
            shot.depth = shot.depth_confidence = None
    unsure: dict[str, list[str]] = {}
    for shot in shots:
        if (sure := shot.depth_confidence) and not missing_extra(sure) and (why := _of_another_shape(root, sure, shot, "confidence")):
            unsure.setdefault(why, []).append(sure)
            files.append(sure)
            shot.depth_confidence = None
    lines = [_told_unfit(why, those) for why, those in left_out.items()]
    lines += [_told_unfit(why, those, "confidence map") for why, those in unsure.items()]
    return (*told(shots), *lines), tuple(files)


def _told_unfit(why: str, files: Sequence[str], what: str = "depth map") -> str:
    one = len(set(files)) == 1
    count = f"the {what} {files[0]} is" if one else f"{len(set(files))} {what}s (first {files[0]}) are"
    return f"{count} not read: {why}"


def _unfit(root: Path, shot: Shot) -> str | None:
    """Why the map of ``shot`` cannot be used; None if it can be opened and has the shape of its picture."""
    assert shot.depth is not None
    if extra := missing_extra(shot.depth):
        return f"that needs pip install 'e4dgs[{extra}]'"
    if shot.depth.lower().endswith(IMAGES):
        try:
            with open_image(root / shot.depth) as opened:
                if opened.mode not in GREY:  # a picture of depth in colours
                    return (
                        f"a picture of depth must have one channel of grey, not {opened.mode}; export depth as PNG of 16 bits, NPY or EXR"
                    )
        except BadImageError:
            return "such a file cannot be opened; copy it again"
    return _of_another_shape(root, shot.depth, shot, "depth")


def _of_another_shape(root: Path, file: str, shot: Shot, what: str) -> str | None:
    """What is wrong with the size that ``file`` states; None if it has the shape of the picture of ``shot``, or states none. Of a map that
    shows another part of the view, which part is not known, and stretched to the picture it would be wrong everywhere."""
    try:
        size = stated_size(root / file)
    except BadImageError:  # the stage `frames` refuses it
        return None
    if size is None or abs(size[0] * shot.size[1] / (size[1] * shot.size[0]) - 1) < SHAPE:
        return None
    return (
        f"{what} must have the shape of its picture; export it for the picture as it is stored, or cut both to the part that both show (it "
        f"is {size[0]}x{size[1]}, its picture {shot.size[0]}x{shot.size[1]})"
    )


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
