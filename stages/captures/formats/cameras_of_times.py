"""Which camera took each picture, where files say when and from where, but not by which camera."""

from __future__ import annotations

import posixpath
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..reading import TRAIN, Shot


def fixed_cameras(shots: Sequence[Shot]) -> bool:
    """Whether these are fixed cameras that saw several times, of which some pictures may be missing. Then `Shot.camera` is set."""
    times = _times(shots)
    distinct = len(set(times))
    if distinct in (1, len(times)):
        return False
    # The same pose and lens at several times is one fixed camera, or two if their pictures lie in two folders.
    poses = _poses(shots)
    for keys in (poses, [(_folder(shot), *pose) for shot, pose in zip(shots, poses, strict=True)]):
        seen: dict[Any, list[float]] = {}
        for key, time in zip(keys, times, strict=True):
            seen.setdefault(key, []).append(time)
        fixed = all(len(set(mine)) == len(mine) > 1 for mine in seen.values())
        if fixed and 2 * len(shots) >= len(seen) * distinct:  # as for all captures, at most half of the pictures may be missing
            ids = {key: i for i, key in enumerate(seen)}
            for shot, key in zip(shots, keys, strict=True):
                shot.camera = ids[key]
            return True
    return False


def moving_cameras(shots: Sequence[Shot]) -> None:
    """Sets `Shot.camera` where several frames share a time and the cameras move: one camera if it alone trains, those of the folders if
    no folder saw a time twice, and else one for each frame."""
    times = _times(shots)
    if len(set(times)) in (1, len(times)):
        return
    training = [time for shot, time in zip(shots, times, strict=True) if shot.split == TRAIN]
    alone = len(set(training)) == len(training) < len(shots)  # one moving camera trains, and others are held out at its times
    folders: dict[str, list[float]] = {}
    for shot, time in zip(shots, times, strict=True):
        folders.setdefault(_folder(shot), []).append(time)
    apart = len(folders) > 1 and all(len(set(mine)) == len(mine) > 1 for mine in folders.values())
    ids = {pose: i for i, pose in enumerate(dict.fromkeys(_poses(shots)), 1)}
    names = {folder: i for i, folder in enumerate(folders)}
    for i, (shot, pose) in enumerate(zip(shots, _poses(shots), strict=True)):
        if alone:
            shot.camera = 0 if shot.split == TRAIN else ids[pose]
        else:
            shot.camera = names[_folder(shot)] if apart else i


def _times(shots: Sequence[Shot]) -> list[float]:
    return [round(shot.time, 9) for shot in shots]


def _folder(shot: Shot) -> str:
    return posixpath.dirname(shot.file or "")


def _poses(shots: Sequence[Shot]) -> list[tuple[float, ...]]:
    """Pose and lens of each shot, rounded; those of shots that have both."""
    return [
        tuple(np.round(np.concatenate([s.cam_from_world.ravel(), s.K.ravel()]), 5))
        for s in shots
        if s.cam_from_world is not None and s.K is not None
    ]
