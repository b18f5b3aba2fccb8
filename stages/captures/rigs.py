"""Several cameras of one capture: whether folders of images are the cameras of a rig, and whether cameras stand still."""

from __future__ import annotations

import posixpath
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from . import checks
from .capture import Shot


def cameras_of(root: Path, images: Sequence[str]) -> tuple[list[tuple[str, int]] | None, str | None]:
    """(camera, index of its time) for each of `images`, paths relative to `root`, if they lie in several folders that contain files of the
    same names: `cam0/0001.jpg` and `cam1/0001.jpg` show the same time. Otherwise None, with a note for people if there are several folders.

    The folders are compared rather than `images`, from which structure from motion may have dropped some frames of some cameras."""
    folders = folders_of(images)
    if len(folders) < 2:
        return None, None
    frames = {folder: _frames(root, folder) for folder in folders}
    first = frames[folders[0]]
    number = {frame: i for i, frame in enumerate(first)}
    other = next((folder for folder in folders if frames[folder] != first), None)
    if other is None and all(_frame(name) in number for name in images):
        return [(posixpath.dirname(name), number[_frame(name)]) for name in images], None
    counts = "" if other is None else f" ({len(first)} in {folders[0]}, {len(frames[other])} in {other})"
    return None, (
        f"{len(folders)} folders of images do not hold files of the same names{counts}, so they are read as one camera over time, in the "
        "order of their names; for a rig of cameras name the frames of one time alike"
    )


def all_fixed(shots: Sequence[Shot]) -> bool:
    """Whether these are several cameras with poses, each with only one pose."""
    first: dict[object, np.ndarray] = {}
    for shot in shots:
        pose = shot.cam_from_world
        if pose is not None and np.abs(first.setdefault(shot.camera, pose) - pose).max() > 1e-6:
            return False
    return len(first) > 1


def folders_of(images: Sequence[str]) -> list[str]:
    return sorted({posixpath.dirname(name) for name in images}, key=checks.natural_key)


def _frames(root: Path, folder: str) -> list[str]:
    names = [name for name in checks.list_folder(root / folder) if name.lower().endswith(checks.IMAGE_SUFFIXES)]
    return sorted({_frame(name) for name in names}, key=checks.natural_key)


def _frame(name: str) -> str:
    return posixpath.splitext(posixpath.basename(name))[0]
