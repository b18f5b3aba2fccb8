"""Stray Scanner's recordings: `rgb.mp4`, `odometry.csv`, `camera_matrix.csv`, and `depth/000000.png` of LiDAR (mm, 256x192) with
`confidence/000000.png` (0 to 2) for each frame.

`odometry.csv` has a header and for each frame of the video timestamp, frame, x, y, z, qx, qy, qz, qw: camera to world in metres, OpenCV
axes. `camera_matrix.csv` is the 3x3 matrix for the video. Older recordings have neither timestamp nor frame, and depth as NPY. Facts from
github.com/strayrobots/scanner (docs/format.md) and github.com/kekeblom/StrayVisualizer, which fuses their depth.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .....pipeline import CaptureError, counted
from ... import checks
from ...posed.matrix_files import numbers_of, text_of
from ...posed.rotations import rotation
from ...posed.stated import states_layout
from ...reading import Options, Reading, Shot, Video
from ..video import MOST_FRAMES, MOST_OF_MOVING, choose, refuse_one, survey

_VIDEO, _POSES, _MATRIX = "rgb.mp4", "odometry.csv", "camera_matrix.csv"
_COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")


def detect(root: Path) -> str | None:
    there = not states_layout(root) and all((root / name).is_file() for name in (_VIDEO, _POSES, _MATRIX))
    return f"{_POSES} of Stray Scanner and {_VIDEO}" if there else None


def read(root: Path, options: Options) -> Reading:
    for name in (_VIDEO, _POSES, _MATRIX):
        if not (root / name).is_file():
            raise CaptureError(f"{name}: missing in {root}; a recording of Stray Scanner has {_VIDEO}, {_POSES} and {_MATRIX}")
        checks.resolve_inside(root, name, name)
    header = survey(root, _VIDEO)
    total, size = len(header.seconds), (header.width, header.height)
    K, poses = _matrix(root, size), _poses(root)
    posed = [i for i in range(total) if i in poses]
    if 2 * len(posed) < max(total, len(poses)):
        raise CaptureError(f"{_POSES}: poses for {len(posed)} of the {total} frames of {_VIDEO}; check that both are of one recording")
    chosen = choose(len(posed), options, MOST_FRAMES if options.static else MOST_OF_MOVING)
    refuse_one(_VIDEO, chosen, len(posed), options)
    taken = tuple(posed[k] for k in chosen)
    begin = header.seconds[taken[0]]
    shots = []
    for i in taken:
        time = header.seconds[i]
        shot = Shot(f"{_VIDEO}#{i}", 0, time, size, seconds=time - begin, K=K, cam_from_world=checks.inverse(poses[i]))
        shot.depth, shot.depth_confidence = (_map_of(root, folder, i) for folder in ("depth", "confidence"))
        shot.depth_confidence = shot.depth_confidence if shot.depth else None
        shots.append(shot)
    some = f"all {len(posed)}" if len(taken) == len(posed) else f"{len(taken)} of {len(posed)}"
    notes = [f"took {some} video frames that have a pose; frames.every and frames.max_frames change it"]
    for one, of, its, other in (("frame", _VIDEO, total, _POSES), ("pose", _POSES, len(poses), _VIDEO)):
        if left := its - len(posed):
            notes.append(f"{counted(left, one)} of {of} without a counterpart in {other}: left out")
    return Reading(
        why=f"{_POSES} of Stray Scanner and {_VIDEO}, one moving camera",
        shots=shots,
        fps=header.fps,
        sources=(_POSES, _MATRIX),
        videos=(Video(_VIDEO, 0, taken, total),),
        notes=tuple(notes),
        spoken_for=tuple(name for name in ("imu.csv", "depth", "confidence") if (root / name).exists()),
    )


def _matrix(root: Path, size: tuple[int, int]) -> np.ndarray:
    """K [3,3] px of `camera_matrix.csv`, which must be for the video."""
    K = np.reshape(numbers_of(text_of(root, _MATRIX), _MATRIX, (9,)), (3, 3))
    K = checks.intrinsics(float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), _MATRIX, skew=float(K[0, 1]))
    if not all(0.25 < K[axis, 2] / side < 0.75 for axis, side in enumerate(size)):
        raise CaptureError(
            f"{_MATRIX}: the principal point {K[0, 2]:g}, {K[1, 2]:g} is far from the middle of {_VIDEO}, {size[0]}x{size[1]} px; "
            "give the video as the app wrote it, or scale the first two rows to it"
        )
    return K


def _poses(root: Path) -> dict[int, np.ndarray]:
    """[4,4] `world_from_cam` by the number of the frame, which is that of the row where no column says it."""
    lines = [line for line in text_of(root, _POSES).splitlines() if line.strip()]
    names = [name.strip().lower() for name in lines[0].split(",")] if lines else []
    if missing := [name for name in _COLUMNS if name not in names]:
        raise CaptureError(f"{_POSES}: its first line names no column {', '.join(missing)}; export it again")
    places = [names.index(name) for name in _COLUMNS]
    found: dict[int, np.ndarray] = {}
    for number, line in enumerate(lines[1:], 2):
        where = f"{_POSES}: line {number}"
        values = numbers_of(line, where, (len(names),))
        row, frame = values[places], values[names.index("frame")] if "frame" in names else number - 2.0
        if not (np.isfinite([frame, *row]).all() and frame == int(frame) and frame >= 0):
            raise CaptureError(f"{where}: expected a frame's number and finite values, found {line.strip()[:80]!r}; remove the line")
        if int(frame) in found:
            raise CaptureError(f"{where}: frame {int(frame)} has two poses; remove one")
        pose = np.eye(4)
        pose[:3, :3] = rotation((row[6], *row[3:6]), where)
        pose[:3, 3] = row[:3]
        found[int(frame)] = checks.rigid(pose, where)
    return found


def _map_of(root: Path, folder: str, i: int) -> str | None:
    names = (f"{folder}/{i:06d}{suffix}" for suffix in (".png", ".npy"))
    return next((name for name in names if (root / name).is_file()), None)
