"""Cameras of `transforms*.json`, the format shared by NeRF, D-NeRF, instant-ngp and nerfstudio.

Poses are camera-to-world in OpenGL axes (x right, y up, z back); ours are `cam_from_world` in OpenCV axes (x right, y down,
z forward). Intrinsics in these files assume pixel centres at +0.5 (COLMAP's convention), as ours do, and are used unchanged.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ....pipeline import CaptureError
from .. import checks
from ..lens import LARGEST_TERM, Lens, distortion_of
from ..posed.finding import Found, find_pictures_of_splits
from ..posed.focals import CONTRADICTION, focal_lengths, matrix_of
from ..posed.sizes import scale_of

OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
_PERSPECTIVE = ("OPENCV", "FULL_OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")
_FISHEYE = ("OPENCV_FISHEYE", "FISHEYE", "SIMPLE_FISHEYE", "RADIAL_FISHEYE", "SIMPLE_RADIAL_FISHEYE")
_TERMS = ("k1", "k2", "k3", "k4", "p1", "p2")  # the order of nerfstudio's `distortion_params`


def pose(frame: Mapping[str, Any], where: str) -> np.ndarray:
    """[4,4] `cam_from_world` (OpenCV) of one frame's `transform_matrix`."""
    field = f"{where}: transform_matrix"
    world_from_cam = checks.rigid(checks.matrix(frame.get("transform_matrix"), field, ((4, 4), (3, 4))), field)
    return checks.inverse(world_from_cam @ OPENCV_FROM_OPENGL)


def lens(
    frame: Mapping[str, Any], top: Mapping[str, Any], where: str, root: Path, picture: str, size: tuple[int, int], said: list[str]
) -> Lens:
    """The lens of one frame for its `picture` of `size`. Values of the frame take precedence over those at the top of the file.

    Focal lengths may be given in pixels (`fl_x`), as an angle (`camera_angle_x` in radians, `x_fov` and `fov` in degrees) or in a matrix
    (`K`, `intrinsics`); two that contradict each other are an error. If `w` and `h` differ from the size of the picture by a common
    factor, K is scaled (pictures were resized after calibration). said: gets a line for the first frame of which something is ignored.
    """

    def value(key: str, low: float = -1e12, high: float = 1e12, of: Mapping[str, Any] | None = None) -> float | None:
        raw = frame.get(key, top.get(key)) if of is None else of.get(key)
        return None if raw is None else checks.number(raw, f"{where}: {key}", low, high)

    model = frame.get("camera_model", top.get("camera_model", "OPENCV"))
    name = model.upper() if isinstance(model, str) else ""
    if name not in _PERSPECTIVE + _FISHEYE:
        raise CaptureError(
            f"{where}: camera_model: {str(model)[:40]} is not supported ({', '.join(_PERSPECTIVE + _FISHEYE)} are); "
            "undistort the images to a pinhole camera first"
        )
    fisheye = name in _FISHEYE or bool(frame.get("is_fisheye", top.get("is_fisheye")))
    made_for = value("w", 1, 1e6) or float(size[0]), value("h", 1, 1e6) or float(size[1])
    sx, sy = scale_of(root, picture, size, made_for, f"{where}: w, h say")
    matrix = matrix_of(frame, top, where)
    fx, fy = focal_lengths(value, frame, top, made_for, matrix, where, said)
    fx, fy = fx if fx is not None else fy, fy if fy is not None else fx
    if fx is None or fy is None:
        raise CaptureError(f"{where}: neither fl_x nor camera_angle_x; add the focal length in pixels as fl_x")
    centre = []
    for key, extent, place in (("cx", made_for[0], (0, 2)), ("cy", made_for[1], (1, 2))):
        given = value(key)
        centre.append(given if given is not None else extent / 2 if matrix is None else float(matrix[place]))
        if given is not None and matrix is not None and abs(given - matrix[place]) > CONTRADICTION * extent:
            raise CaptureError(f"{where}: {key} = {given:g}, but the camera matrix says {matrix[place]:g}; correct or remove one of them")
    cx, cy = centre
    width, height = made_for
    if not (-width <= cx <= 2 * width and -height <= cy <= 2 * height):
        raise CaptureError(
            f"{where}: cx, cy = {cx:g}, {cy:g} lie far outside the {width:g}x{height:g} image; "
            "give w and h of the calibrated image, or correct cx and cy"
        )
    frame = _with_terms(frame, top, where, fisheye)
    used = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    if name == "FULL_OPENCV" and not fisheye:
        used = (*used, "k4", "k5", "k6")
    for key in ("k4", "k5", "k6", "p1", "p2"):
        if key not in used and value(key):
            kind = "fisheye" if fisheye else "OPENCV"
            also = "" if fisheye else " (FULL_OPENCV lenses also have k4, k5, k6)"
            raise CaptureError(
                f"{where}: {key}: {kind} lenses have {', '.join(used)}{also}; correct camera_model, or undistort the images first"
            )
    distortion = [value(key, -LARGEST_TERM, LARGEST_TERM) or 0.0 for key in used]
    return Lens(checks.intrinsics(fx * sx, fy * sy, cx * sx, cy * sy, where), distortion_of(distortion), fisheye)


def frames_of(data: Mapping[str, Any], file: str) -> list[dict[str, Any]]:
    """The `frames` list of one file. Every entry is checked to be an object."""
    frames = checks.items(data.get("frames"), f"{file}: frames")
    for i, frame in enumerate(frames):
        if not isinstance(frame, dict):
            raise CaptureError(f"{file}: frame {i}: expected an object with file_path and transform_matrix; correct the file")
    return frames


def present(root: Path, train: str, frames: Mapping[str, list[dict[str, Any]]]) -> dict[str, Found]:
    """The pictures of frames of several files by their names, see `find_pictures_of_splits`: instant-ngp's own captures list frames whose
    images were removed because of blur."""
    return find_pictures_of_splits(root, train, {file: _names(own, file) for file, own in frames.items()})


def _names(frames: list[dict[str, Any]], file: str) -> dict[int, tuple[str, str]]:
    places = [f"{file}: frame {i}: file_path" for i in range(len(frames))]
    return {i: (checks.text(frame.get("file_path"), places[i]), places[i]) for i, frame in enumerate(frames)}


def times_of(frames: list[dict[str, Any]], file: str) -> list[float] | None:
    """`time` of every frame; None if no frame has one. It is an error if only some frames have one."""
    missing = [i for i, frame in enumerate(frames) if frame.get("time") is None]
    if len(missing) == len(frames):
        return None
    if missing:
        raise CaptureError(f"{file}: frame {missing[0]}: time is missing, but other frames have one; give every frame a time, or none")
    return [checks.number(frame["time"], f"{file}: frame {i}: time") for i, frame in enumerate(frames)]


def _with_terms(frame: Mapping[str, Any], top: Mapping[str, Any], where: str, fisheye: bool) -> Mapping[str, Any]:
    """``frame`` with each term of the lens by its name, if it has them as `distortion_params`, or the file and the frame has none."""
    raw = frame.get("distortion_params")
    if raw is None and not any(key in frame for key in _TERMS):
        raw = top.get("distortion_params")
    if raw is None:
        return frame
    counts = (4, 6) if fisheye else (6,)  # four of another lens may be in OpenCV's order as well
    return {**frame, **dict(zip(_TERMS, checks.numbers(raw, f"{where}: distortion_params", counts, LARGEST_TERM), strict=False))}
