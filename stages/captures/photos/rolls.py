"""The photos of one camera in several folders, one after the other: cameras and phones begin a folder (DCIM/101APPLE) when one is full."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from ....vision.images.files import BadImageError, open_image
from .. import checks
from ..exposure import KINDS
from ..listing.kinds import PICTURE, colour_only, kind_of
from ..listing.names import is_image, is_video
from ..listing.numbers import SPLIT_WORDS
from ..posed.time_folders import named_as_cameras

_OF_CAMERA = re.compile(r"[1-9]\d\d[A-Z0-9_]{5}")  # of the standard DCF: 100APPLE, 100CANON, 101_PANA
_OUTER = ("DCIM", "images")  # folders that hold such folders
_MOST_MISSING = 10  # photos, deleted between two folders whose names say nothing
_MAKE, _MODEL = 0x010F, 0x0110
_LONGEST = 40  # letters of either


class Roll(NamedTuple):
    """prefix: the folder of the folders with "/", empty for that of the capture. names: pictures in order of time, relative to the capture.
    note: what was decided, for people."""

    prefix: str
    names: list[str]
    note: str


def roll(root: Path) -> Roll | None:
    """The photos of the folders in `root`, or in its DCIM/ or images/, if they are one camera's: the numbers in their names differ, and go
    on from folder to folder, or the folders are named as cameras name theirs; no EXIF data name another camera. None elsewhere, and if
    there are videos that belong to no photo."""
    if not root.is_dir():
        return None
    top = _folders(root, "")
    outer = next((name for name in _OUTER if name in top), None)
    if outer and any(_pictures(root, name) for name in top):
        outer = None
    prefix, folders = (f"{outer}/", _folders(root, outer)) if outer else ("", top)
    listed = {folder: _pictures(root, folder) for folder in folders}
    listed = {folder: names for folder, names in listed.items() if names}
    if not listed or _films(root, folders) or not _follow(listed) or len(cameras := _cameras(root, listed)) > 1:
        return None
    first = {folder: _number(names[0]) or 0 for folder, names in listed.items()}
    order = list(listed) if _of_camera(listed) else sorted(listed, key=first.__getitem__)
    names = [name for folder in order for name in listed[folder]]
    parts = ", ".join(f"{folder}/ ({len(listed[folder])})" for folder in order[:4]) + (", ..." if len(order) > 4 else "")
    seen = "by their names and numbers" + (f" and EXIF ({next(iter(cameras))})" if cameras else "")
    several = f"{len(order)} folders of photos are" if len(order) > 1 else "the folder of photos is"
    return Roll(
        prefix,
        names,
        f"{several} read as one sequence of one camera, {seen}: {parts}, in this order; if they are several cameras or scenes, pass one "
        "folder, or encode one video of each camera and give the folder of videos",
    )


def _follow(listed: dict[str, list[str]]) -> bool:
    """Whether pictures in folders are one sequence by their names. listed: folders and their pictures."""
    names = [name for those in listed.values() for name in those]
    numbers = [_number(name) for name in names]
    if None in numbers or len(set(numbers)) < len(names):
        return False
    if _of_camera(listed):
        return True
    folders = [posixpath.basename(folder) for folder in listed]
    if any(map(_OF_CAMERA.fullmatch, folders)):  # of several cameras
        return False
    words = {re.sub(r"\d+", "0", posixpath.splitext(posixpath.basename(name))[0]) for name in names}
    if len(folders) < 2 or len(words) > 1 or named_as_cameras(list(listed)) or any(folder.lower() in SPLIT_WORDS for folder in folders):
        return False
    if any(len(re.findall(r"\d+", posixpath.basename(posixpath.splitext(name)[0]))) != 1 for name in names):
        return False  # of two numbers, one may be the camera
    spans = sorted((min(found), max(found)) for those in listed.values() if (found := [_number(name) or 0 for name in those]))
    return all(0 < begin - end <= 1 + _MOST_MISSING for (_, end), (begin, _) in pairwise(spans))


def _of_camera(listed: dict[str, list[str]]) -> bool:
    """Whether folders have names that one camera gives one after the other."""
    names = [posixpath.basename(folder) for folder in listed]
    if not all(map(_OF_CAMERA.fullmatch, names)):
        return False
    return len({re.sub(r"\d+", "0", name) for name in names}) == 1 and len({name[:3] for name in names}) == len(names)


def _number(name: str) -> int | None:
    """The last number in the name of a picture."""
    found = re.findall(r"\d{1,18}", posixpath.splitext(posixpath.basename(name))[0])
    return int(found[-1]) if found else None


def _folders(root: Path, folder: str) -> list[str]:
    """Folders in a folder, relative to `root`, but for those of depth, masks and the like."""
    found = [posixpath.join(folder, name) for name in checks.list_folder(root / folder)]
    return [name for name in found if kind_of(f"{name}/0.png") is PICTURE and (root / name).is_dir() and not checks.is_foreign(root / name)]


def _pictures(root: Path, folder: str) -> list[str]:
    return [f"{folder}/{name}" for name in colour_only([name for name in checks.list_files(root / folder) if is_image(name)])]


def _films(root: Path, folders: Sequence[str]) -> bool:
    """Whether a folder has a video that is not the clip that a phone writes beside a photo."""
    for folder in folders:
        files = checks.list_files(root / folder)
        stems = {posixpath.splitext(name)[0].lower() for name in files if not is_video(name)}
        if any(is_video(name) and posixpath.splitext(name)[0].lower() not in stems for name in files):
            return True
    return False


def _cameras(root: Path, listed: dict[str, list[str]]) -> set[str]:
    """Make and model that EXIF data of the first picture of each folder give."""
    found = set()
    for names in listed.values():
        try:
            with open_image(root / names[0]) as image:
                exif = image.getexif() if image.format in KINDS else {}
                told = " ".join(str(exif[tag])[:_LONGEST] for tag in (_MAKE, _MODEL) if tag in exif)
        except BadImageError:  # its reader says why
            continue
        told = "".join(letter for letter in told if letter.isprintable()).strip()  # a file may hold anything, and people read it
        found |= {told} if told else set()
    return found
