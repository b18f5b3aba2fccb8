"""The camera path in a JSON file: the pose, lens and time of each picture, and the size and rate of them all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...pipeline import CaptureError
from ...scene.formats.axes import OPENGL
from ...stages.captures import checks
from ...stages.captures.assembly.far_away import seen_from
from ...stages.exports.camera_path import NAMES, CameraPath
from .path_lens import BENT, FIELDS, lens_of, refuse_other_kinds, size_of

if TYPE_CHECKING:
    from ...stages.shared.posed_frameset import PosedFrameSet

MOST_FRAMES = 100_000
POSES = ("cam_from_world", "transform_matrix", "camera_to_world")
TIMES = ("time", "render_time")
# Fields that say nothing about how a view looks: of captures, and of nerfstudio's editor, which has put them into its `camera_path`.
QUIET = (
    *("file_path", "mask_path", "depth_file_path", "colmap_im_id", "sharpness", "rotation", "name", "aabb_scale", "ply_file_path"),
    *("applied_transform", "applied_scale", "train_filenames", "val_filenames", "test_filenames"),
    *("keyframes", "default_fov", "default_transition_sec", "is_cycle", "smoothness_value"),
)
NERFSTUDIO = (
    "the poses of camera_path are taken to be in the world of the capture's files; nerfstudio's viewer writes them in its own, which is "
    "the same only if it was trained without turning, centring and scaling (--orientation-method none --center-method none "
    "--auto-scale-poses False)"
)


@dataclass
class FilePath(CameraPath):
    """The path in a file. size: (width, height) px of the pictures, to which K refers. fps: pictures per second, if it says so. notes: what
    was assumed and what was not read, a line each."""

    size: tuple[int, int]
    fps: float | None
    notes: tuple[str, ...]


def path_of_file(file: Path, frames: PosedFrameSet) -> FilePath:
    """The path in a JSON file: ``{"frames": [{...}]}`` or nerfstudio's ``{"camera_path": [{...}]}``.

    Each view has one of ``cam_from_world`` (4x4, OpenCV), ``transform_matrix`` and ``camera_to_world`` (4x4 or 16 numbers row by row,
    camera to world, OpenGL, as nerfstudio and Blender write it), and optionally ``time`` (``render_time``) in [0, 1] and a lens; lens,
    size, ``fps`` and ``seconds`` may also stand at the top (see `path_lens`). Poses are in the world of the capture's files. Without a lens
    it is that of the capture's first training frame; without times, time runs once from 0 to 1. Raises CaptureError that names file, frame
    and field.
    """
    data, rows = _rows(file)
    name = f"--path {file}"
    refuse_other_kinds(data, name)
    size, stated = size_of(data, rows, (frames.width, frames.height), name)
    poses, lenses = [], []
    for i, row in enumerate(rows):
        where = f"{name}: frame {i}"
        poses.append(_pose(row, where))
        refuse_other_kinds(row, where)
        lenses.append(lens_of(data, row, size, where))
    usual = _of_capture(frames, size)
    found = np.stack(poses) @ _of_export(data, name)
    if frames.origin is not None:
        found = seen_from(frames.origin, found)
    fps, notes = _rate(data, len(rows), name)
    notes += _notes(data, rows, size, stated, name)
    return FilePath(found, np.stack([usual if K is None else K for K in lenses]), _times(rows, name), size, fps, tuple(notes))


def _rows(file: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The object in ``file``, and the views in it."""
    try:
        data = checks.read_json(file.parent, file.name)
    except CaptureError as error:
        raise CaptureError(
            f'--path {file}: this is not a camera path in JSON ({error}); expected {{"frames": [...]}}, or one of {", ".join(NAMES)}'
        ) from error
    given = [name for name in ("frames", "camera_path") if name in data]
    if len(given) == 2:
        raise CaptureError(f'--path {file}: it has both "frames" and "camera_path"; remove one of them')
    name = given[0] if given else "frames"
    rows = data.get(name)
    if not isinstance(rows, list) or not 0 < len(rows) <= MOST_FRAMES:
        raise CaptureError(f'--path {file}: "{name}" must be a list of 1 to {MOST_FRAMES} views')
    for i, row in enumerate(rows):
        if not isinstance(row, dict):
            raise CaptureError(f"--path {file}: frame {i}: expected an object with one of {', '.join(POSES)}")
    return data, rows


def _pose(row: Mapping[str, Any], where: str) -> np.ndarray:
    given = [name for name in POSES if name in row]
    if not given:
        raise CaptureError(f"{where}: it has neither cam_from_world nor transform_matrix nor camera_to_world; add one")
    if len(given) > 1:
        raise CaptureError(f"{where}: it has both {given[0]} and {given[1]}; remove one of them")
    value, where = row[given[0]], f"{where}: {given[0]}"
    if given[0] == "camera_to_world" and isinstance(value, list) and len(value) == 16 and not any(isinstance(v, list) for v in value):
        value = [value[k : k + 4] for k in range(0, 16, 4)]
    pose = checks.rigid(checks.matrix(value, where, ((4, 4), (3, 4))), where)
    return pose if given[0] == "cam_from_world" else checks.inverse(pose @ OPENGL)


def _of_export(data: Mapping[str, Any], name: str) -> np.ndarray:
    """[4, 4], world of the poses from world of the capture's files: what `e4dgs export cameras` says, else nothing changes."""
    value, where = data.get("file_from_capture"), f"{name}: file_from_capture"
    return np.eye(4) if value is None else checks.rigid(checks.matrix(value, where, ((4, 4),)), where)


def _times(rows: Sequence[Mapping[str, Any]], name: str) -> np.ndarray:
    """[n] in [0, 1]."""
    times = [next((row[key] for key in TIMES if key in row), None) for row in rows]
    if all(time is None for time in times):
        return np.linspace(0, 1, len(rows))
    for i, time in enumerate(times):
        if time is None:
            raise CaptureError(f"{name}: frame {i}: it has no time, but other frames have; give all of them one, or none")
        if isinstance(time, bool) or not isinstance(time, int | float) or not 0 <= time <= 1:
            raise CaptureError(f"{name}: frame {i}: time: expected a number from 0 to 1, got {time!r:.40}")
    return np.array(times, np.float64)


def _of_capture(frames: PosedFrameSet, size: tuple[int, int]) -> np.ndarray:
    """The lens of the capture's first training frame for pictures of ``size``: as high, so that a wider picture shows more at the sides."""
    K = frames.K[frames.train[0]]
    if size == (frames.width, frames.height):
        return K
    scale = size[1] / frames.height
    middle = (K[0, 2] - 0.5 * frames.width) * scale, (K[1, 2] - 0.5 * frames.height) * scale
    return np.array([[K[0, 0] * scale, 0, 0.5 * size[0] + middle[0]], [0, K[1, 1] * scale, 0.5 * size[1] + middle[1]], [0, 0, 1]])


def _rate(data: Mapping[str, Any], count: int, name: str) -> tuple[float | None, list[str]]:
    """(pictures per second, notes): from seconds, as nerfstudio does it, else from fps."""
    fps = checks.number(data["fps"], f"{name}: fps", 1e-3, 1e3) if data.get("fps") is not None else None
    if data.get("seconds") is None:
        return fps, []
    seconds = checks.number(data["seconds"], f"{name}: seconds", 1e-3, 1e6)
    if fps is None:
        return count / seconds, []
    if abs(fps * seconds - count) <= 1.0:  # rounding
        return fps, []
    return count / seconds, [f"fps ({fps:g}) and seconds ({seconds:g}) do not fit {count} views; the video takes {seconds:g} s"]


def _notes(data: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], size: tuple[int, int], stated: bool, name: str) -> list[str]:
    notes = [NERFSTUDIO] if "camera_path" in data else []
    levels = (data, *rows)
    if not stated and any(key in fields for fields in levels for key in ("K", "fl_x", "fl_y")):
        notes.append(f"the file gives no w and h, so its lens is taken to be in px of pictures of {size[0]}x{size[1]}")
    aspects = [checks.number(row["aspect"], f"{name}: aspect", 1e-3, 1e3) for row in levels if "aspect" in row] if stated else []
    wrong = [aspect for aspect in aspects if abs(aspect * size[1] / size[0] - 1) > 0.01]
    if wrong:
        notes.append(
            f"aspect ({wrong[0]:.4g}) is not that of pictures of {size[0]}x{size[1]} in {len(wrong)} places; the size is what counts"
        )
    bent = sorted({key for fields in levels for key in BENT if fields.get(key) not in (None, 0)})
    if bent:
        notes.append(f"the distortion of the lens ({', '.join(bent)}) is not rendered: straight lines stay straight")
    known = {*POSES, *TIMES, *FIELDS, *QUIET, "frames", "camera_path", "fps", "seconds", "camera", "file_from_capture"}
    strange = sorted({key for fields in levels for key, value in fields.items() if key not in known and value is not None})
    if strange:
        more = f" and {len(strange) - 8} more" if len(strange) > 8 else ""
        notes.append(f"these fields are not read: {', '.join(repr(key[:40])[1:-1] for key in strange[:8])}{more}")
    return notes
