"""A model of one time of a rig: one picture with a pose in each folder, as a calibration on the first frames leaves."""

from __future__ import annotations

import posixpath
from collections.abc import Mapping
from pathlib import Path

from ... import checks
from ...rigs import folders_of, pictures_in

_SHARED = 0.5  # of a folder's pictures; names of fewer in common may be chance


def extend_standing(root: Path, posed: Mapping[int, str], static: bool) -> tuple[list[tuple[int, str]], str | None]:
    """(entry, picture) for each picture that has a pose, and a line for people if poses were extended to others.

    posed: the picture of each entry of a model, relative to `root`. If each of several folders holds exactly one of them and further
    pictures, and those of all folders have the same names, the cameras stand still: each pose holds for all pictures of its folder whose
    names all folders share. static: all show one time, so that the further ones would add nothing."""
    same = list(posed.items())
    folders = folders_of(list(posed.values()))
    if static or len(folders) < 2 or len(folders) < len(posed):
        return same, None
    named = {folder: {_frame(path): path for path in pictures_in(root, folder)} for folder in folders}
    shared = set.intersection(*(set(names) for names in named.values()))
    if len(shared) < 2 or any(len(shared) < _SHARED * len(names) for names in named.values()):
        return same, None
    entries = {posixpath.dirname(path): entry for entry, path in posed.items()}
    pairs = {names[frame]: entries[folder] for folder, names in named.items() for frame in shared}
    first = posed[entries[folders[0]]]
    note = (
        f"each of {len(folders)} folders has one picture with a pose (first {first}): its camera is taken to stand still, and the pose "
        f"holds for all {len(shared)} pictures of the folder; if the cameras moved, run structure from motion on all pictures"
    )
    return [(pairs[path], path) for path in checks.in_order(pairs)], note


def _frame(path: str) -> str:
    return posixpath.splitext(posixpath.basename(path))[0]
