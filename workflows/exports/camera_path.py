"""The camera path that a person asks for by name or in a JSON file: the pose, lens and time of each picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...pipeline import CaptureError, SettingsError
from ...stages.captures import checks
from ...stages.captures.far_away import seen_from
from ...stages.exports.camera_path import NAMES, CameraPath, named_path

if TYPE_CHECKING:
    from ...scene.model import Model
    from ...stages.artifacts.frameset import FrameSet

MOST_FRAMES = 100_000
_LARGEST = 1e7  # px
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # x right, y up, z back


def path_of_file(file: Path, frames: FrameSet) -> CameraPath:
    """The path in a JSON file: ``{"frames": [{...}]}``, each frame with ``cam_from_world`` (4x4, OpenCV) or ``transform_matrix`` (4x4,
    camera to world, OpenGL, as nerfstudio and Blender write it), and optionally ``K`` (3x3 px) and ``time`` in [0, 1].

    Poses are in the world of the capture's files. Without K, the lens of the capture's first training frame is used; without times, time
    runs once from 0 to 1. Raises CaptureError that names file, frame and field.
    """
    try:
        data = checks.read_json(file.parent, file.name)
    except CaptureError as error:
        raise CaptureError(
            f'--path {file}: this is not a camera path in JSON ({error}); expected {{"frames": [...]}}, or one of {", ".join(NAMES)}'
        ) from error
    rows = data.get("frames")
    if not isinstance(rows, list) or not 0 < len(rows) <= MOST_FRAMES:
        raise CaptureError(f'--path {file}: "frames" must be a list of 1 to {MOST_FRAMES} views')
    assert frames.K is not None
    poses, lenses, times = [], [], []
    for i, row in enumerate(rows):
        where = f"--path {file}: frame {i}"
        if not isinstance(row, dict):
            raise CaptureError(f"{where}: expected an object with cam_from_world or transform_matrix")
        if "cam_from_world" in row:
            poses.append(_pose(row["cam_from_world"], f"{where}: cam_from_world"))
        elif "transform_matrix" in row:
            poses.append(checks.inverse(_pose(row["transform_matrix"], f"{where}: transform_matrix") @ OPENGL))
        else:
            raise CaptureError(f"{where}: it has neither cam_from_world nor transform_matrix; add one")
        lenses.append(_lens(row["K"], f"{where}: K") if "K" in row else frames.K[frames.train[0]])
        time = row.get("time", i / max(len(rows) - 1, 1))
        if isinstance(time, bool) or not isinstance(time, int | float) or not 0 <= time <= 1:
            raise CaptureError(f"{where}: time: expected a number from 0 to 1, got {time!r:.40}")
        times.append(float(time))
    moved = np.stack(poses) if frames.origin is None else seen_from(frames.origin, np.stack(poses))
    return CameraPath(moved, np.stack(lenses), np.array(times))


def _pose(value: Any, where: str) -> np.ndarray:
    return checks.rigid(checks.matrix(value, where, ((4, 4), (3, 4))), where)


def _lens(value: Any, where: str) -> np.ndarray:
    K = checks.matrix(value, where, ((3, 3),))
    for name, entry in (("fx", K[0, 0]), ("fy", K[1, 1]), ("cx", K[0, 2]), ("cy", K[1, 2])):
        checks.number(float(entry), f"{where}: {name}", -_LARGEST, _LARGEST)
    return checks.intrinsics(K[0, 0], K[1, 1], K[0, 2], K[1, 2], where, skew=K[0, 1])


def resolve(path: str, frames: FrameSet, model: Model, count: int | None) -> CameraPath:
    """The path that ``--path`` and ``--frames`` ask for. Raises SettingsError for a name that is neither a known path nor a file."""
    if path in NAMES:
        return named_path(path, frames, model, count or 120)
    if not Path(path).is_file():
        raise SettingsError(f"--path {path}: neither one of {', '.join(NAMES)} nor a file")
    if count is not None:
        raise SettingsError("--frames: a path file defines its number of views itself; leave --frames out")
    return path_of_file(Path(path), frames)
