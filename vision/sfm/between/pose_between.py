"""`pose_between`: poses of the frames between those of which structure from motion found poses and points.

The points' features in the nearest posed frame on either side are followed into a frame (Lucas and Kanade, IJCAI 1981), and the pose is
the one under which the points lie there, by a robust adjustment that begins between the poses of the two. That takes a small part of the
time of features, matches and mapping (benchmarks/results/trials.md).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ..alignment import camera_centres
from .resect import resect

MOST = 600  # points of a posed frame that are followed: those of the longest tracks
WINDOW, LEVELS = (21, 21), 3  # of the tracker: px, and halvings of the picture
BACK = 0.0007  # of the longer side: what is followed there and back must come this near
SCALE, FITS = 0.0004, 0.002  # of the longer side: of the loss; points nearer than the second agree with the pose
FEWEST, SHARE = 30, 0.3  # least number and least share of the followed points that must agree
LOOSE = 0.5  # standard deviation of a centre from where it is expected, relative to how far the camera moves between posed frames


class Posed(NamedTuple):
    """A frame with a pose: its number, cam_from_world [4, 4], and N features: xy [N, 2] px, points [N, 3] in the world."""

    frame: int
    cam_from_world: np.ndarray
    xy: np.ndarray
    points: np.ndarray


class Lens(NamedTuple):
    """K [3, 3] px, pixel centres at +0.5; distortion [4]: k1 k2 p1 p2."""

    K: np.ndarray
    distortion: np.ndarray


def pose_between(
    frames: np.ndarray, arrays: Mapping[str, np.ndarray], count: int, picture: Callable[[int], np.ndarray], advance: Callable[[], None]
) -> dict[str, np.ndarray]:
    """The ``arrays`` of structure from motion on ``frames`` [n] as arrays of all ``count`` frames of the camera.

    frames: increasing, from 0. arrays: as `worker.reconstruct.reconstruct` returns them. picture(i): uint8 [H, W, 3] of frame i, distorted.
    advance: called once for each of the other frames. One of them gets a pose only if its neighbours among ``frames`` have one; those
    after the last of ``frames``, if the last two have.
    """
    import cv2

    whole = spread(frames, arrays, count)
    grey = lru_cache(maxsize=3)(lambda i: cv2.cvtColor(picture(i), cv2.COLOR_RGB2GRAY))
    posed = lru_cache(maxsize=2)(lambda k: _posed(k, int(frames[k]), arrays))
    steps = np.linalg.norm(np.diff(camera_centres(arrays["cam_from_world"]), axis=0), axis=1)
    usual = float(np.median(steps[np.isfinite(steps)])) if np.isfinite(steps).any() else 0.0
    for i in np.setdiff1d(np.arange(count), frames).tolist():
        advance()
        after = min(int(np.searchsorted(frames, i)), len(frames) - 1)
        if after < 1 or not arrays["registered"][[after - 1, after]].all():
            continue
        ends = posed(after - 1), posed(after)
        lens = Lens(arrays["K"][after], arrays["distortion"][after])
        size = arrays["size"][after]
        near = ends if i < frames[after] else ends[1:]
        expected = _expected(i, *ends)
        sights = [_followed(one, expected, lens, size, grey(one.frame), grey(i)) for one in near]
        apart = float(np.linalg.norm(np.diff(camera_centres(np.stack([one.cam_from_world for one in ends])), axis=0)))
        # a hand may shake out and back between two posed frames, which then lie in one place
        pose = _pose(sights, expected, lens, float(size.max()), LOOSE * max(apart, usual))
        if pose is not None:
            whole["registered"][i], whole["cam_from_world"][i] = True, pose
            whole["K"][i], whole["distortion"][i], whole["size"][i] = *lens, size
    return whole


def spread(frames: np.ndarray, arrays: Mapping[str, np.ndarray], count: int) -> dict[str, np.ndarray]:
    """``arrays`` of ``frames`` as arrays of ``count`` frames, of which the others have no pose."""
    whole = dict(arrays)
    empty = {"registered": False, "K": np.nan, "cam_from_world": np.nan, "distortion": 0.0, "size": 0, "explained": np.nan}
    for name in empty.keys() & arrays.keys():
        whole[name] = np.full((count, *arrays[name].shape[1:]), empty[name], arrays[name].dtype)
        whole[name][frames] = arrays[name]
    whole["seen"] = frames[arrays["seen"]].astype(np.int32)
    return whole


def _posed(k: int, frame: int, arrays: Mapping[str, np.ndarray]) -> Posed:
    row = np.flatnonzero(arrays["track_frame"] == k)
    point = np.repeat(np.arange(len(arrays["tracks"])), arrays["tracks"])[row]
    best = np.argsort(-arrays["tracks"][point], kind="stable")[:MOST]
    return Posed(frame, arrays["cam_from_world"][k], arrays["track_xy"][row[best]], arrays["points"][point[best]])


def _expected(i: int, first: Posed, second: Posed) -> np.ndarray:
    """Pose [4, 4] of frame ``i`` if the camera moves steadily between two posed frames, and on after the second."""
    share = (i - first.frame) / (second.frame - first.frame)
    poses = np.stack([first.cam_from_world, second.cam_from_world])
    a, b = camera_centres(poses)
    turn = Rotation.from_matrix(poses[1, :3, :3] @ poses[0, :3, :3].T).as_rotvec()
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(share * turn).as_matrix() @ poses[0, :3, :3]
    pose[:3, 3] = -pose[:3, :3] @ (a + share * (b - a))
    return pose


def _followed(
    one: Posed, expected: np.ndarray, lens: Lens, size: np.ndarray, there: np.ndarray, here: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(points [n, 3], places [n, 2] px of the distorted picture ``here``) of the features of ``one`` that are found ``here`` and lead back.

    ``there``, ``here``: grey pictures, whose size may differ from ``size``, to which the lens and the features belong."""
    import cv2

    scale = np.array(here.shape[::-1]) / size
    moved = _seen(one.points, expected, lens.K) - _seen(one.points, one.cam_from_world, lens.K)
    begin = ((one.xy * scale) - 0.5).astype(np.float32)  # OpenCV counts pixel centres from 0
    guess = np.where(np.isfinite(moved), begin + moved * scale, begin).astype(np.float32)
    flags = cv2.OPTFLOW_USE_INITIAL_FLOW
    end, found, _ = cv2.calcOpticalFlowPyrLK(there, here, begin, guess, winSize=WINDOW, maxLevel=LEVELS, flags=flags)
    back, returned, _ = cv2.calcOpticalFlowPyrLK(here, there, end, begin.copy(), winSize=WINDOW, maxLevel=LEVELS, flags=flags)
    good = (found.ravel() > 0) & (returned.ravel() > 0) & (np.linalg.norm(back - begin, axis=1) < BACK * max(here.shape))
    return one.points[good], (end[good].astype(np.float64) + 0.5) / scale


def _seen(points: np.ndarray, pose: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Places [N, 2] px of ``points`` in a pinhole camera; NaN behind it."""
    local = points @ pose[:3, :3].T + pose[:3, 3]
    depth = np.where(local[:, 2:] > 0, local[:, 2:], np.nan)
    return np.asarray(local[:, :2] / depth * K[[0, 1], [0, 1]] + K[:2, 2])


def _pose(sights: list[tuple[np.ndarray, np.ndarray]], expected: np.ndarray, lens: Lens, side: float, loose: float) -> np.ndarray | None:
    """The pose [4, 4] under which the followed points lie where they were found; None if too few agree."""
    import cv2

    points, places = (np.concatenate(one) for one in zip(*sights, strict=True))
    if len(points) < FEWEST:
        return None
    straight = cv2.undistortPoints(places[:, None], lens.K, lens.distortion)[:, 0]
    focal = float(lens.K[0, 0])
    pose, errors = resect(points, straight, expected, SCALE * side / focal, loose)
    agree = int((errors < FITS * side / focal).sum())
    return pose if agree >= max(FEWEST, SHARE * len(points)) else None
