"""Focal lengths of `transforms*.json`, given in pixels, as angles or in a matrix, and whether they agree."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ....pipeline import CaptureError
from .. import checks

CONTRADICTION = 0.05  # largest relative difference of two values for one thing; angles are often given with two digits
_MATRICES = ("K", "intrinsics", "intrinsic", "camera_intrinsics", "intrinsic_matrix")  # fields for a camera matrix


def focal_lengths(
    value: Callable[..., float | None],
    frame: Mapping[str, Any],
    top: Mapping[str, Any],
    extent: tuple[float, float],
    matrix: np.ndarray | None,
    where: str,
    said: list[str],
) -> tuple[float | None, float | None]:
    """(fx, fy), px; None for an axis without any. extent: width and height, px, of the calibrated picture. said: gets a line for the first
    frame whose angles are those of a sensor. Raises CaptureError for values that contradict each other."""
    x, y = (_focals(value, frame, top, axis, side, matrix) for axis, side in zip("xy", extent, strict=True))
    if ignored := _of_sensor(x, y, extent):
        if not said:
            names = " and ".join(ignored)
            said.append(
                f"{where}: fl_x and fl_y are used, and {names} {'is' if len(ignored) == 1 else 'are'} ignored, because "
                "Blender's angles are those of its sensor, whatever the shape of the picture"
            )
        x, y = ({words: focal for words, focal in one.items() if words not in ignored} for one in (x, y))
    return _agreed(x, where, extent[0]), _agreed(y, where, extent[1])


def _of_sensor(x: dict[str, float], y: dict[str, float], extent: tuple[float, float]) -> list[str]:
    """The words of angles that contradict focal lengths in pixels as Blender's do: they are those of a sensor of, usually, 36 mm by 24 mm,
    one side of which spans one side of the picture. Then one angle is right, or that of the sensor's width belongs to the height of an
    upright picture. Empty if this does not explain what contradicts."""
    pixels = [next((focal for words, focal in one.items() if words.startswith("fl_")), None) for one in (x, y)]
    angles = [next((words for words in one if words.startswith("camera_angle_")), None) for one in (x, y)]
    (fx, fy), (across, down), (width, height) = pixels, angles, extent
    if fx is None or fy is None or across is None or down is None or not _close(fx, fy):
        return []
    wrong = [words for words, focal, given in ((across, x[across], fx), (down, y[down], fy)) if not _close(focal, given)]
    upright = height > width and _close(x[across] * height / width, fx)
    return wrong if len(wrong) == 1 or upright else []


def _close(focal: float, other: float) -> bool:
    return other > 0 and abs(focal / other - 1) <= CONTRADICTION


def matrix_of(frame: Mapping[str, Any], top: Mapping[str, Any], where: str) -> np.ndarray | None:
    """[3,3] px of a frame or file that gives a camera matrix; None without one."""
    for key in _MATRICES:
        raw = frame.get(key, top.get(key))
        if isinstance(raw, list):
            matrix = checks.matrix(raw, f"{where}: {key}", ((3, 3), (3, 4), (4, 4)))[:3, :3]
            checks.intrinsics(matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], f"{where}: {key}", skew=matrix[0, 1])
            return matrix
    return None


def _focals(
    value: Callable[..., float | None],
    frame: Mapping[str, Any],
    top: Mapping[str, Any],
    axis: str,
    extent: float,
    matrix: np.ndarray | None,
) -> dict[str, float]:
    """All focal lengths, px, for one axis, by the words for a message: those of the frame, or of the file if the frame has none."""
    keys = (f"fl_{axis}", f"camera_angle_{axis}", f"{axis}_fov", *(("fov",) if axis == "x" else ()))
    of = frame if any(frame.get(key) is not None for key in (*keys, *_MATRICES)) else top
    matrix = matrix if any(isinstance(of.get(key), list) for key in _MATRICES) else None
    found: dict[str, float] = {}
    pixels = value(keys[0], of=of)
    if pixels is not None:
        found[f"fl_{axis} = {pixels:g} px"] = pixels
    if matrix is not None:
        entry = float(matrix[0, 0] if axis == "x" else matrix[1, 1])
        found[f"the camera matrix ({entry:g} px)"] = entry
    radians = value(keys[1], 1e-6, math.pi - 1e-6, of)
    if radians is not None:
        found[f"camera_angle_{axis} = {radians:g} rad"] = 0.5 * extent / math.tan(0.5 * radians)
    for key in keys[2:]:
        degrees = value(key, 1e-4, 180 - 1e-4, of)
        if degrees is not None:
            found[f"{key} = {degrees:g} degrees"] = 0.5 * extent / math.tan(0.5 * math.radians(degrees))
    return found


def _agreed(focals: dict[str, float], where: str, extent: float) -> float | None:
    """The first of several focal lengths. Raises CaptureError if another contradicts it."""
    if not focals:
        return None
    (words, first), *others = focals.items()
    for other, focal in others:
        if first > 0 and abs(focal / first - 1) > CONTRADICTION:
            raise CaptureError(
                f"{where}: {words} and {other} (which is {focal:.4g} px for {extent:g} px) contradict each other; correct or remove one "
                "of them, or give w and h of the calibrated pictures"
            )
    return first
