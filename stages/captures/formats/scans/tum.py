"""TUM RGB-D: `rgb.txt` (time stamp, picture), `groundtruth.txt` (time stamp, tx ty tz qx qy qz qw) and `rgb/`.

Poses are those of the colour camera, camera to world, OpenCV axes. They have clocks of their own: the pose at a picture's time is
interpolated between the two nearest. Facts, intrinsics included, from cvg.cit.tum.de/data/datasets/rgbd-dataset (file_formats,
intrinsic_calibration).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .....pipeline import CaptureError
from ... import checks
from ...lens import Lens, distortion_of
from ...posed.depth import told_depth
from ...posed.finding import find_pictures, left_out
from ...posed.matrix_files import intrinsics_of, numbers_of, text_of
from ...posed.rotations import rotation
from ...posed.sizes import scale_of
from ...posed.stated import states_layout
from ...reading import Options, Reading, Shot

_PICTURES, _POSES = "rgb.txt", "groundtruth.txt"
_GAP = 0.1  # s, longest time between two poses that is interpolated; motion capture has 0.01
_ALONE = 0.02  # s, farthest from a single pose, as in the tools of TUM
_MOST = 2_000_000
# fx fy cx cy, and k1 k2 p1 p2 k3, for 640x480
_CAMERAS = {
    "freiburg1": ((517.3, 516.5, 318.6, 255.3), (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "freiburg2": ((520.9, 521.0, 325.1, 249.7), (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "freiburg3": ((535.4, 539.2, 320.1, 247.6), (0.0, 0.0, 0.0, 0.0, 0.0)),
}


def detect(root: Path) -> str | None:
    there = not states_layout(root) and all((root / name).is_file() for name in (_PICTURES, _POSES))
    return f"{_PICTURES} and {_POSES}" if there else None


def read(root: Path, options: Options) -> Reading:
    for name in (_PICTURES, _POSES):
        if not (root / name).is_file():
            raise CaptureError(f"{name}: missing in {root}; the TUM RGB-D layout has {_PICTURES} and {_POSES}")
    listed = _lines(root, _PICTURES, 2)
    stamps, poses = _trajectory(root)
    names = {i: (words[1], f"{_PICTURES}: line {line}") for i, (line, words) in enumerate(listed)}
    found = find_pictures(root, names, _PICTURES, "lines")
    times = {i: _stamp(listed[i][1][0], f"{_PICTURES}: line {listed[i][0]}: time stamp") for i in found.paths}
    posed = {i: pose for i in found.paths if (pose := _at(times[i], stamps, poses)) is not None}
    unposed = [found.paths[i] for i in found.paths if i not in posed]
    if 2 * len(unposed) > len(found.paths):
        raise CaptureError(
            f"{_POSES}: no pose near the times of {len(unposed)} of {len(found.paths)} pictures; check that it is of this recording"
        )
    files = [found.paths[i] for i in posed]
    sizes, alpha = checks.image_headers(root, files)
    source, lens, made_for, note = _lens(root)
    begin = min(times[i] for i in posed)
    shots = []
    for i, file, size in zip(posed, files, sizes, strict=True):
        shot = Shot(name=file, camera=0, time=times[i] - begin, size=size, file=file, seconds=times[i] - begin)
        shot.cam_from_world = checks.inverse(checks.rigid(posed[i], f"{_POSES}: pose at {times[i]:.6f}"))
        shot.K = np.diag([*scale_of(root, file, size, made_for or sizes[0], f"{source}: for"), 1.0]) @ lens.K
        shot.distortion = lens.distortion
        shots.append(shot)
    notes = [left_out(unposed, len(found.paths), f"pictures have no pose of {_POSES} near their times and are left out")] if unposed else []
    unread = tuple(name for name in ("depth.txt", "depth", "accelerometer.txt") if (root / name).exists())
    return Reading(
        why=f"{_PICTURES} and {_POSES}, one moving camera",
        shots=shots,
        alpha=alpha,
        sources=(*((source,) if note is None else ()), _PICTURES, _POSES),
        notes=(*found.notes, *((note,) if note else ()), *notes),
        depth_notes=told_depth(root, unread, "no depth map has the time of a picture, and accelerations are not used"),
        spoken_for=(*unread, *unposed),
    )


def _lines(root: Path, name: str, least: int) -> list[tuple[int, list[str]]]:
    """(number, words) of the lines that are no comments."""
    result = []
    for number, line in enumerate(text_of(root, name).splitlines(), 1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) < least:
            raise CaptureError(f"{name}: line {number}: expected {least} words, found {len(words)}; correct the file")
        result.append((number, words))
    if not result or len(result) > _MOST:
        raise CaptureError(f"{name}: {len(result)} lines; expected one for each picture or pose")
    return result


def _stamp(word: str, where: str) -> float:
    return checks.number(float(numbers_of(word, where, (1,))[0]), where)


def _trajectory(root: Path) -> tuple[np.ndarray, np.ndarray]:
    """Time stamps [P] in ascending order, and [P,7] tx ty tz qx qy qz qw."""
    rows = np.stack([numbers_of(" ".join(words[:8]), f"{_POSES}: line {line}", (8,)) for line, words in _lines(root, _POSES, 8)])
    good = rows[np.isfinite(rows).all(1)]
    if len(good) < 2:
        raise CaptureError(f"{_POSES}: {len(good)} poses; a trajectory needs at least two")
    good = good[np.argsort(good[:, 0], kind="stable")]
    return good[:, 0], good[:, 1:]


def _at(time: float, stamps: np.ndarray, poses: np.ndarray) -> np.ndarray | None:
    """[4,4] `world_from_cam` at a time; interpolated; None where no pose is near."""
    after = int(np.searchsorted(stamps, time))
    before, after = max(0, after - 1), min(after, len(stamps) - 1)
    span = float(stamps[after] - stamps[before])
    nearest = min(abs(time - float(stamps[before])), abs(time - float(stamps[after])))
    if nearest > _ALONE and (span > _GAP or not stamps[before] <= time <= stamps[after]):
        return None
    share = min(1.0, max(0.0, (time - float(stamps[before])) / span)) if span > 0 else 0.0
    a, b = poses[before], poses[after]
    qa, qb = a[3:] / max(1e-12, np.linalg.norm(a[3:])), b[3:] / max(1e-12, np.linalg.norm(b[3:]))
    qx, qy, qz, qw = (1 - share) * qa + share * (qb if qa @ qb >= 0 else -qb)
    result = np.eye(4)
    result[:3, :3] = rotation((qw, qx, qy, qz), f"{_POSES}: pose at {time:.6f}")
    result[:3, 3] = (1 - share) * a[:3] + share * b[:3]
    return result


def _lens(root: Path) -> tuple[str, Lens, tuple[int, int] | None, str | None]:
    """(source, lens, size that it is for, note if no file gives it)."""
    given = intrinsics_of(root)
    if given is not None:
        return given[0], Lens(given[1], np.zeros(4)), given[2], None
    for name, ((fx, fy, cx, cy), terms) in _CAMERAS.items():
        if name in root.name.lower():
            K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
            k1, k2, p1, p2, k3 = terms
            told = f"no file gives the intrinsics; taken are those that TUM publishes for {name} ({fx:g} px); add K.txt to correct them"
            return name, Lens(K, distortion_of((k1, k2, p1, p2, k3))), (640, 480), told
    raise CaptureError(
        f"{root}: the files give poses but no intrinsics, and the folder's name does not say freiburg1, 2 or 3; add K.txt, nine numbers of "
        "the 3x3 camera matrix in px"
    )
