"""`triangulate`: initial points for captures that have camera poses but no points."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Protocol

import numpy as np
from PIL import Image

from ..pipeline import StageError
from ..pipeline.choice.evenly import evenly
from .sfm.alignment import camera_centres
from .sfm.runner import WorkerError, run_worker

MAX_ERROR = 2.0  # px, in every view of a point
MIN_ANGLE = 1.0  # degrees between the outermost rays of a point
MIN_TRACK = 3  # views: any two features on an epipolar line triangulate, only a third view verifies the point; where no frame has
# two others to be matched with, as in a rig of two cameras, two views must do
MAX_FEATURES = 3072
MAX_FRAMES = 90
ERROR_SPREAD = 1.75  # times the median error; four in five of the points that match by chance on an epipolar line have a larger error
NEIGHBOURS = 8  # nearest cameras that each camera is matched with
STEPS = (1, 2, 4, 8)  # distances between the chosen frames of one moving camera that are matched
MAX_TURN = 75.0  # degrees between viewing directions


class PosedPictures(Protocol):
    """Frames of one size with the cameras that are known; a capture's `FrameSet` has more."""

    K: np.ndarray | None  # [F, 3, 3] px
    cam_from_world: np.ndarray | None  # [F, 4, 4], OpenCV
    train: np.ndarray  # indices of the frames to use
    time: np.ndarray  # [F]
    width: int  # px
    height: int

    def composited(self, i: int, /) -> np.ndarray:
        """Frame i as uint8 [H, W, 3]."""
        ...


def triangulate(frameset: PosedPictures, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangulates SIFT features of the training frames with their known cameras.

    At most about `MAX_FRAMES` frames are read. Cameras that see the same time are matched with one another, never across times. A moving
    camera is matched with itself over time; points on moving objects then fail the test of the reprojection error.

    Returns points [P,3] float64 (world), colors [P,3] uint8 (RGB), errors [P] float64 (mean reprojection error, px). Points lie in front
    of all their cameras and project to within 2 px of their features. At least three views see them, or two if no frame is in two pairs,
    with rays that differ by at least 1 degree. P may be 0. Raises StageError if the frames have no poses or COLMAP fails.
    """
    if frameset.K is None or frameset.cam_from_world is None:
        raise StageError("triangulation needs poses; the capture has none and `poses` did not run")
    frames = choose_frames(np.asarray(frameset.train), np.asarray(frameset.time), MAX_FRAMES)
    poses = np.asarray(frameset.cam_from_world, np.float64)[frames]
    pairs = choose_pairs(poses, np.asarray(frameset.time)[frames])
    empty = np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros(0)
    if not pairs:
        return empty
    with tempfile.TemporaryDirectory(prefix="e4dgs-points-") as temporary:
        folder = Path(temporary)
        names = _write_images(frameset, frames, folder / "images")
        request = {
            "task": "triangulate",
            "root": str(folder / "images"),
            "names": names,
            "K": np.asarray(frameset.K, np.float64)[frames].tolist(),
            "cam_from_world": poses.tolist(),
            "width": frameset.width,
            "height": frameset.height,
            "pairs": pairs,
            "max_features": MAX_FEATURES,
            "seed": seed,
            "max_error": MAX_ERROR,
            "min_angle": MIN_ANGLE,
            "min_track": MIN_TRACK if thrice(pairs) else 2,
        }
        try:
            arrays, _ = run_worker(request, folder)
        except WorkerError as error:
            raise StageError(f"triangulating points with known poses failed. {error}") from error
    keep = keep_precise(arrays["errors"])
    return arrays["points"][keep], arrays["colors"][keep], arrays["errors"][keep]


def keep_precise(errors: np.ndarray) -> np.ndarray:
    """[P] bool: points whose error is near the median, which is the precision that the poses and features of this capture allow."""
    return errors <= ERROR_SPREAD * np.median(errors) if len(errors) else np.zeros(0, bool)


def choose_frames(train: np.ndarray, time: np.ndarray, max_frames: int) -> np.ndarray:
    """Sorted indices of the frames to use: all cameras at some evenly spread times, or for one camera frames evenly spread over time."""
    times = np.unique(time[train])
    cameras = len(train) / max(1, len(times))
    if cameras < 2 or len(times) == 1:
        return evenly(train, max_frames)
    wanted = evenly(times, max(1, min(3, int(max_frames / cameras))))
    return train[np.isin(time[train], wanted)]


def choose_pairs(cam_from_world: np.ndarray, time: np.ndarray) -> list[tuple[int, int]]:
    """Pairs (a, b), a < b: nearest cameras of the same time; for one moving camera also frames close in time."""
    centres = camera_centres(cam_from_world)
    forward = cam_from_world[:, 2, :3]
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    turn = np.degrees(np.arccos(np.clip(forward @ forward.T, -1, 1)))
    span = max(float(apart.max()), 1e-12)
    allowed = (turn <= MAX_TURN) & (apart > 1e-6 * span)
    rig = len(np.unique(time)) <= len(time) / 2
    if rig:
        allowed &= time[:, None] == time[None]
    pairs: set[tuple[int, int]] = set()
    # Turning away counts as distance, as moving away does: both leave fewer features in common.
    cost = np.where(allowed, apart / span + np.radians(turn), np.inf)
    count = NEIGHBOURS if rig else NEIGHBOURS // 2
    for a, row in enumerate(cost):
        nearest = np.argsort(row, kind="stable")[:count]
        pairs |= {(min(a, int(b)), max(a, int(b))) for b in nearest if np.isfinite(row[b])}
    if not rig:
        order = np.argsort(time, kind="stable")
        for step in STEPS:
            for first, second in zip(order[:-step], order[step:]):
                if allowed[first, second]:
                    pairs.add((int(min(first, second)), int(max(first, second))))
    return sorted(pairs)


def thrice(pairs: list[tuple[int, int]]) -> bool:
    """Whether some frame is in two pairs, so that a point can have three views."""
    return len({frame for pair in pairs for frame in pair}) < 2 * len(pairs)


def _write_images(frameset: PosedPictures, frames: np.ndarray, folder: Path) -> list[str]:
    folder.mkdir()
    names = [f"{n:06d}.png" for n in range(len(frames))]
    for n, i in enumerate(frames):
        Image.fromarray(frameset.composited(int(i))).save(folder / names[n], compress_level=1)
    return names
