"""The views that a person asks for by name or by a JSON file: where the camera is at each picture, through which lens, at what time."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..pipeline import CaptureError, SettingsError
from ..stages.camera_path import NAMES, CameraPath, named_path

if TYPE_CHECKING:
    from ..scene.model import Model
    from ..stages.frameset import FrameSet

MOST_FRAMES = 100_000
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # x right, y up, z back


def path_of_file(file: Path, frames: FrameSet) -> CameraPath:
    """Views of a JSON file: ``{"frames": [{...}]}``, each with ``cam_from_world`` (4x4, OpenCV) or ``transform_matrix`` (4x4, camera to
    world, OpenGL, as nerfstudio and Blender write it), and, if wanted, ``K`` (3x3 px) and ``time`` in [0, 1].

    Without a lens the capture's first is taken, without times they go by once. Raises CaptureError that names file, frame and field.
    """
    try:
        data = json.loads(file.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        raise CaptureError(f"--path {file}: this is no camera path in JSON ({error}); or give one of {', '.join(NAMES)}") from error
    rows = data.get("frames") if isinstance(data, dict) else None
    if not isinstance(rows, list) or not 0 < len(rows) <= MOST_FRAMES:
        raise CaptureError(f'--path {file}: "frames" must be a list of 1 to {MOST_FRAMES} views')
    assert frames.K is not None
    poses, lenses, times = [], [], []
    for i, row in enumerate(rows):
        where = f"--path {file}: frame {i}"
        if not isinstance(row, dict):
            raise CaptureError(f"{where}: expected an object with cam_from_world or transform_matrix")
        if "cam_from_world" in row:
            poses.append(_matrix(row["cam_from_world"], 4, f"{where}: cam_from_world"))
        elif "transform_matrix" in row:
            poses.append(np.linalg.inv(_matrix(row["transform_matrix"], 4, f"{where}: transform_matrix") @ OPENGL))
        else:
            raise CaptureError(f"{where}: it has neither cam_from_world nor transform_matrix; add one")
        lenses.append(_matrix(row["K"], 3, f"{where}: K") if "K" in row else frames.K[frames.train[0]])
        time = row.get("time", i / max(len(rows) - 1, 1))
        if isinstance(time, bool) or not isinstance(time, int | float) or not 0 <= time <= 1:
            raise CaptureError(f"{where}: time: expected a number from 0 to 1, got {time!r:.40}")
        times.append(float(time))
    return CameraPath(np.stack(poses), np.stack(lenses), np.array(times))


def _matrix(value: Any, size: int, where: str) -> np.ndarray:
    try:
        matrix = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape != (size, size) or not np.isfinite(matrix).all():
        raise CaptureError(f"{where}: expected {size}x{size} finite numbers")
    if abs(np.linalg.det(matrix[:3, :3])) < 1e-12:
        raise CaptureError(f"{where}: the matrix cannot be inverted")
    return matrix


def resolve(path: str, frames: FrameSet, model: Model, count: int | None) -> CameraPath:
    """What ``--path`` and ``--frames`` ask for. Raises SettingsError for a name that is neither a path nor a file."""
    if path in NAMES:
        return named_path(path, frames, model, count or 120)
    if not Path(path).is_file():
        raise SettingsError(f"--path {path}: neither one of {', '.join(NAMES)} nor a file")
    if count is not None:
        raise SettingsError("--frames: a file says itself how many views it has; leave it out")
    return path_of_file(Path(path), frames)
