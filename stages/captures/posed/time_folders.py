"""Whether folders of pictures are times (`images/0007/cam2.png`) rather than cameras (`images/cam2/0007.png`): by poses, else by names."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Sequence

import numpy as np

from ..reading import Shot

_SAME_POSE = 1e-6  # largest difference of two matrices
_CAMERA = re.compile(r"(?:.*[^a-z])?(?:cam|camera|view|left|right|gopro|kinect)[^a-z0-9]?\d*")


def folders_are_times(shots: Sequence[Shot]) -> tuple[bool, str | None]:
    """Whether the folders of ``shots``, whose files lie in several, are times, and the name of a file is its camera. And a line for people
    where the poses do not say so: cameras that all move, or that all share a place."""
    files = [shot.file or shot.name for shot in shots]
    folders, names = [posixpath.dirname(file) for file in files], [frame_of(file) for file in files]
    distinct = sorted(set(folders))
    if not _are_numbered(distinct):
        return False, None
    by_folder, by_name = _fixed(shots, folders), _fixed(shots, names)
    if by_folder != by_name:
        return by_name, None
    many = f"{len(distinct)} folders with pictures of the same names (first {distinct[0]}), whose poses do not tell cameras from times,"
    if named_as_times(distinct, names):
        return (
            True,
            f"{many} are read as times, and the names as cameras, since the folders are numbers; for cameras name them cam0/, cam1/",
        )
    if all(map(str.isdecimal, (*map(posixpath.basename, distinct), *names))):
        return False, f"{many} are read as cameras, and the names as times; if it is the other way round, name the pictures cam0, cam1, ..."
    return False, None


def named_as_times(folders: Sequence[str], names: Sequence[str]) -> bool:
    """Whether ``folders`` are bare numbers of one width, and ``names`` (of their files, without suffix) words or numbered cameras."""
    last = [posixpath.basename(folder) for folder in folders]
    return (
        all(map(str.isdecimal, last))
        and len(set(map(len, last))) == 1
        and all(name.isalpha() or _CAMERA.fullmatch(name.lower()) for name in names)
    )


def named_as_cameras(folders: Sequence[str]) -> bool:
    """Whether all ``folders`` have names of cameras, such as `cam01` or `left`."""
    return all(_CAMERA.fullmatch(posixpath.basename(folder).lower()) for folder in folders)


def _are_numbered(folders: Sequence[str]) -> bool:
    """Whether the names of folders differ in nothing but numbers, and do not say that these are cameras."""
    parts = {tuple(re.split(r"\d+", folder)) for folder in folders}
    return len(parts) == 1 and len(next(iter(parts))) > 1 and not named_as_cameras(folders[:1])


def _fixed(shots: Sequence[Shot], keys: Sequence[str]) -> bool:
    """Whether the shots with one key share a pose, as those of a fixed camera do, and most keys have several."""
    first: dict[str, np.ndarray] = {}
    several = set()
    for shot, key in zip(shots, keys, strict=True):
        if shot.cam_from_world is None:
            return False
        if key in first:
            several.add(key)
        if np.abs(first.setdefault(key, shot.cam_from_world) - shot.cam_from_world).max() > _SAME_POSE:
            return False
    return 2 * len(several) > len(first)


def frame_of(name: str) -> str:
    """What the name of a picture says of its time: its stem, without the name of its folder, since `cam1/cam1_0007.png` shows the time of
    `cam2/cam2_0007.png`."""
    folder, file = posixpath.split(name)
    return posixpath.splitext(file)[0].removeprefix(f"{posixpath.basename(folder)}_")
