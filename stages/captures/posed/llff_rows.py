"""Rows of LLFF's `poses_bounds.npy`, which belong to pictures or cameras in the plain order of their names.

[N,17], for each camera a 3x5 matrix whose columns are the camera's down, right and back axes in the world, its centre, and
(h, w, focal); then near and far. LLFF (github.com/Fyusion/LLFF, `imgs2poses.py`) writes the rows in the order of the sorted names, and
the loaders of Plenoptic Video sort as plainly: `cam10` comes before `cam2`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ....pipeline import CaptureError
from .. import checks
from ..arrays import load_array
from .sizes import scale_of

_MOST = 100_000


def rows_of(root: Path, file: str, names: Sequence[str], what: str) -> np.ndarray:
    """[N,17] float64, one row for each of ``names``, which are in plain order."""
    table = load_array(root, file, (17,), most=_MOST)
    if len(table) != len(names):
        raise CaptureError(f"{file}: {len(table)} rows for {len(names)} {what} ({names[0]} .. {names[-1]}); add or remove {what} to match")
    return table


def told_order(file: str, names: Sequence[str]) -> tuple[str, ...]:
    """A note for people if ``names``, in plain order, would have another order by their numbers."""
    if list(names) == sorted(names, key=checks.natural_key):
        return ()
    shown = ", ".join(names[:4])
    return (f"rows of {file} are matched in plain order of names, as LLFF and COLMAP sort them: {shown}, ...; zero-pad the numbers if not",)


def camera_of(row: np.ndarray, where: str, root: Path, picture: str, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """(K, cam_from_world) of one row, for a picture of ``size``. The focal length is scaled from the file's h, w."""
    if not (np.abs(row) < 1e12).all():
        raise CaptureError(f"{where}: holds NaN, Inf or impossibly large numbers; estimate the poses again")
    width, height = size
    matrix = row[:15].reshape(3, 5)
    down, right, back = matrix[:, 0], matrix[:, 1], matrix[:, 2]
    file_height, file_width, focal = (float(v) for v in matrix[:, 4])
    if min(file_height, file_width) < 1:
        raise CaptureError(f"{where}: image size {file_width:g}x{file_height:g} makes no sense; correct columns h and w")
    world_from_cam = np.column_stack([right, down, -back, matrix[:, 3]])
    cam_from_world = checks.inverse(checks.rigid(world_from_cam, where))
    sx, sy = scale_of(root, picture, size, (file_width, file_height), f"{where}: made for")
    return checks.intrinsics(focal * sx, focal * sy, width / 2, height / 2, where), cam_from_world
