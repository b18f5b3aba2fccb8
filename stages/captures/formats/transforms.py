"""Cameras of `transforms*.json`, the format shared by NeRF, D-NeRF, instant-ngp and nerfstudio.

Poses are camera-to-world in OpenGL axes (x right, y up, z back); ours are `cam_from_world` in OpenCV axes (x right, y down,
z forward). Intrinsics in these files assume pixel centres at +0.5 (COLMAP's convention), as ours do, and are used unchanged.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ....pipeline import CaptureError
from .. import checks
from ..lens import LARGEST_TERM, Lens, distortion_of

OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
_PERSPECTIVE = ("OPENCV", "FULL_OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")
_FISHEYE = ("OPENCV_FISHEYE", "FISHEYE", "RADIAL_FISHEYE", "SIMPLE_RADIAL_FISHEYE")


def pose(frame: Mapping[str, Any], where: str) -> np.ndarray:
    """[4,4] `cam_from_world` (OpenCV) of one frame's `transform_matrix`."""
    field = f"{where}: transform_matrix"
    world_from_cam = checks.rigid(checks.matrix(frame.get("transform_matrix"), field, ((4, 4), (3, 4))), field)
    return checks.inverse(world_from_cam @ OPENCV_FROM_OPENGL)


def lens(frame: Mapping[str, Any], top: Mapping[str, Any], where: str, width: int, height: int) -> Lens:
    """The lens of one frame. Values of the frame take precedence over those at the top of the file.

    If `w` and `h` differ from the size of the images by a common factor, K is scaled (images were resized after calibration).
    """

    def value(key: str, low: float = -1e12, high: float = 1e12) -> float | None:
        raw = frame.get(key, top.get(key))
        return None if raw is None else checks.number(raw, f"{where}: {key}", low, high)

    model = frame.get("camera_model", top.get("camera_model", "OPENCV"))
    name = model.upper() if isinstance(model, str) else ""
    if name not in _PERSPECTIVE + _FISHEYE:
        raise CaptureError(
            f"{where}: camera_model: {str(model)[:40]} is not supported ({', '.join(_PERSPECTIVE + _FISHEYE)} are); "
            "undistort the images to a pinhole camera first"
        )
    fisheye = name in _FISHEYE or bool(frame.get("is_fisheye", top.get("is_fisheye")))
    file_width = value("w", 1, 1e6) or float(width)
    file_height = value("h", 1, 1e6) or float(height)
    sx, sy = width / file_width, height / file_height
    if abs(sx / sy - 1) > 0.02:
        raise CaptureError(
            f"{where}: w, h say {file_width:g}x{file_height:g}, but the images are {width}x{height}, which have another aspect ratio; "
            "correct w and h or the images"
        )
    fx = _focal(value("fl_x"), value("camera_angle_x", 1e-6, math.pi - 1e-6), file_width)
    fy = _focal(value("fl_y"), value("camera_angle_y", 1e-6, math.pi - 1e-6), file_height)
    fx, fy = fx if fx is not None else fy, fy if fy is not None else fx
    if fx is None or fy is None:
        raise CaptureError(f"{where}: neither fl_x nor camera_angle_x; add the focal length in pixels as fl_x")
    cx, cy = value("cx"), value("cy")
    cx = file_width / 2 if cx is None else cx
    cy = file_height / 2 if cy is None else cy
    if not (-file_width <= cx <= 2 * file_width and -file_height <= cy <= 2 * file_height):
        raise CaptureError(
            f"{where}: cx, cy = {cx:g}, {cy:g} lie far outside the {file_width:g}x{file_height:g} image; "
            "give w and h of the calibrated image, or correct cx and cy"
        )
    used = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    for key in ("k4", "k5", "k6", "p1", "p2"):
        if key not in used and value(key):
            raise CaptureError(
                f"{where}: {key}: {'fisheye' if fisheye else 'OPENCV'} lenses have {', '.join(used)}; "
                "remove it, or undistort the images first"
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


def present(root: Path, frames: list[dict[str, Any]], file: str) -> tuple[dict[int, str], tuple[str, ...]]:
    """The image of each frame that has one, by index of the frame, and a note with the number of the others: instant-ngp's own captures
    list frames whose images were removed because of blur. Raises CaptureError if more than half are missing."""
    found: dict[int, str] = {}
    gone: list[str] = []
    for i, frame in enumerate(frames):
        where = f"{file}: frame {i}: file_path"
        name = checks.text(frame.get("file_path"), where)
        path = checks.seek_image(root, name, where)
        if path is None:
            gone.append(f"{where}: no image {name[:200]!r}")
        else:
            found[i] = path
    if 2 * len(gone) > len(frames):
        raise CaptureError(
            f"{gone[0]} in {root}, and so for {len(gone)} of {len(frames)} frames; add the files, correct the paths or remove the frames"
        )
    return found, (f"{len(gone)} of {len(frames)} frames of {file} have no image and are left out; first {gone[0]}",) if gone else ()


def times_of(frames: list[dict[str, Any]], file: str) -> list[float] | None:
    """`time` of every frame; None if no frame has one. It is an error if only some frames have one."""
    missing = [i for i, frame in enumerate(frames) if frame.get("time") is None]
    if len(missing) == len(frames):
        return None
    if missing:
        raise CaptureError(f"{file}: frame {missing[0]}: time is missing, but other frames have one; give every frame a time, or none")
    return [checks.number(frame["time"], f"{file}: frame {i}: time") for i, frame in enumerate(frames)]


def _focal(pixels: float | None, angle: float | None, extent: float) -> float | None:
    if pixels is not None:
        return pixels
    return None if angle is None else 0.5 * extent / math.tan(0.5 * angle)
