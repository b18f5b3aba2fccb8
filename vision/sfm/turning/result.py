"""`turning_arrays`: solves a capture whose camera mostly turns; arrays as from `reconstruct`. Runs in the worker process: imports
pycolmap."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from ..alignment import camera_centres
from ..impossible_points import FEWEST, MAX_ERROR
from ..worker.features.database import Report
from ..worker.result import result_arrays
from ..worker.survey import Survey
from .bundle import STEPS
from .solve import FITS, SOLVES, Turning, solve_turning
from .tracks import LONG_ENOUGH

BENT = ("SIMPLE_RADIAL", "RADIAL", "OPENCV")  # lens models with a radial term


def turning_arrays(
    path: Path, request: dict[str, Any], found: Survey, report: Report, fits: float = FITS
) -> tuple[dict[str, np.ndarray], dict[str, Any]] | None:
    """Arrays and facts as `reconstruct` returns them. None for several cameras, or a camera that does more than turn. fits: see
    `solve_turning`."""
    with pycolmap.Database.open(path) as database:
        cameras = database.read_all_cameras()
    if len(set(request["cameras"])) > 1 or len(cameras) != 1:
        return None
    (camera,) = cameras
    focal = camera.mean_focal_length() if camera.has_prior_focal_length else None
    done, most = 0, SOLVES * STEPS

    def tick() -> None:
        nonlocal done
        report("turning", done, most)
        done += 1

    turning = solve_turning(found.matches, found.places, camera.width, camera.height, focal, request["camera_model"] in BENT, fits, tick)
    report("turning", most, most)
    if turning is None:
        return None
    arrays = _arrays(turning, request, camera.width, camera.height)
    count = int(arrays["registered"].sum())
    return arrays, {"parts": [count], "turning": True, "notes": [_told(turning, arrays)]}


def _told(turning: Turning, arrays: dict[str, np.ndarray]) -> str:
    begin = "the camera turns and hardly moves, so cameras were found from how it turns"
    if not turning.moved:
        return f"{begin}; nothing determines distances: all points are placed equally far away, and views from elsewhere will be wrong"
    return (
        f"{begin}, then how it moved: points are seen under a median angle of {np.median(arrays['angles']):.2g} degrees, "
        "so views far from the camera's path will be wrong"
    )


def _arrays(turning: Turning, request: dict[str, Any], width: int, height: int) -> dict[str, np.ndarray]:
    bundle, names = turning.bundle, list(request["names"])
    errors = bundle.errors()
    good, registered, shown = errors <= MAX_ERROR, turning.frames.copy(), np.zeros(len(bundle.d), bool)
    for _ in range(3):  # a frame that is dropped takes observations with it, and perhaps points
        shown = np.bincount(bundle.point[good], minlength=len(bundle.d)) >= LONG_ENOUGH
        good &= shown[bundle.point]
        registered &= np.bincount(bundle.frame[good], minlength=len(names)) >= FEWEST
        good &= registered[bundle.frame]
    arrays = result_arrays(None, names)
    if not good.any():
        return arrays
    arrays["registered"], arrays["size"][registered] = registered, (width, height)
    arrays["K"][registered] = [[bundle.focal, 0, bundle.centre[0]], [0, bundle.focal, bundle.centre[1]], [0, 0, 1]]
    arrays["distortion"][registered, 0] = bundle.k1
    poses = np.tile(np.eye(4), (len(names), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = bundle.R, bundle.t
    arrays["cam_from_world"][registered] = poses[registered]
    shown = np.bincount(bundle.point[good], minlength=len(bundle.d)) > 0
    number = np.cumsum(shown) - 1
    order = np.argsort(number[bundle.point[good]], kind="stable")
    point, frame, xy, error = (x[good][order] for x in (number[bundle.point], bundle.frame, bundle.xy, errors))
    arrays["points"] = bundle.d[shown] / bundle.rho[shown, None]
    arrays["tracks"] = np.bincount(point)
    arrays["errors"] = np.bincount(point, error) / arrays["tracks"]
    arrays["residuals"], arrays["seen"], arrays["seen_xy"] = error, frame.astype(np.int32), xy.astype(np.float32)
    arrays["track_frame"], arrays["track_xy"] = arrays["seen"], arrays["seen_xy"]
    arrays["angles"] = _angles(arrays["points"], camera_centres(poses), point, frame)
    arrays["colors"] = _colors(Path(request["root"]), names, point, frame, xy, len(arrays["points"]))
    return arrays


def _angles(points: np.ndarray, centres: np.ndarray, point: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """[P] degrees between the outermost rays of every point; `point` must be sorted."""
    rays = points[point] - centres[frame]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    starts = np.flatnonzero(np.diff(point, prepend=-1))
    ends = np.append(starts[1:], len(point))
    # not by the arc cosine, which is inaccurate near zero
    widest = [np.linalg.norm(rays[a:b, None] - rays[None, a:b], axis=2).max() for a, b in zip(starts, ends, strict=True)]
    return np.degrees(2 * np.arcsin(np.clip(np.array(widest) / 2, 0.0, 1.0)))


def _colors(root: Path, names: list[str], point: np.ndarray, frame: np.ndarray, xy: np.ndarray, count: int) -> np.ndarray:
    """[count, 3] uint8: mean RGB of the pixels at each point's features."""
    from PIL import Image

    total = np.zeros((count, 3))
    for i in np.unique(frame):
        with Image.open(root / names[i]) as image:
            picture = np.asarray(image.convert("RGB"))
        mine = frame == i
        x, y = np.floor(xy[mine]).astype(int).T
        np.add.at(total, point[mine], picture[np.clip(y, 0, picture.shape[0] - 1), np.clip(x, 0, picture.shape[1] - 1)])
    return np.asarray(np.round(total / np.bincount(point, minlength=count)[:, None]), np.uint8)
