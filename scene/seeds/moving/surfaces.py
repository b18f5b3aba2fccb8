"""The surface of what several cameras see at one time inside their masks, looked for from its visual hull inwards.

With few cameras a visual hull is much larger than the object, and much of its surface lies where nothing is.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import torch

from ...views import Views
from ..slanted import refine
from ..sweep import AGREEING, LEAST_SCORE, DepthMap, beside, keep_agreed, points_of, small_pictures, towards

SPLAT = 7  # px, side of the square in which a point of the hull counts as the nearest
BEHIND = 0.25  # of its depth: how far behind the hull the surface may lie
BEFORE = 0.03  # the same for before it: masks are not exact
TRIES = 10  # depths that are tried between the two
TOLERANCE = 0.02  # of the depth, by which a point must lie before a measured surface to be known as empty space
FRONT = 0.05  # of the depth, by which a point may lie behind the nearest of the hull and still be seen
LEAST_PIXELS = 30  # frames that show less of the hull get no map


def surface_points(
    views: Views, frames: Sequence[int], pictures: Sequence[np.ndarray], masks: Sequence[np.ndarray], hull: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points [n, 3] in world units where at least two of the ``frames`` agree on the depth of what their masks show, their colours
    [n, 3] in [0, 1], and which points of the ``hull`` [P] bool are left to stand for what has no such point: a frame sees them in front,
    where the depth is unknown, and none sees through them.

    frames: of one time; pictures: theirs, uint8 [H, W, 3]; masks: theirs, bool [H, W]; hull [P, 3]: points of the visual hull.
    """
    grey, K = small_pictures(views, frames, pictures)
    size = grey[0].shape[::-1]
    poses = views.cam_from_world[list(frames)]
    others = [beside(views, frames, k, hull) for k in range(len(frames))]
    nearest = [_nearest(K[k], poses[k], hull, size) for k in range(len(frames))]

    def look(k: int) -> DepthMap | None:
        rough = nearest[k]
        wanted = (cv2.resize(masks[k].astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0) & (rough > 0)
        if not others[k] or wanted.sum() < LEAST_PIXELS:
            return None
        low, high = rough[wanted].min() / (1 + BEHIND), rough[wanted].max() * (1 + BEFORE)
        given = grey[k], [grey[j] for j in others[k]], towards(others[k], K, poses, k), AGREEING
        best, most = rough, np.full(rough.shape, -1.0, np.float32)
        for factor in np.linspace(1 - BEFORE, 1 + BEHIND, TRIES):
            one = rough / np.float32(factor)
            score = refine(*given, one, (low, high), TRIES, K[k][0, 0], 0, wanted)[1]
            best, most = np.where(score > most, one, best), np.maximum(score, most)
        found, score = refine(*given, best, (low, high), TRIES, K[k][0, 0], wanted=wanted)
        sure = wanted & (score > LEAST_SCORE) & (found > rough / (1 + BEHIND)) & (found < rough * (1 + BEFORE))
        step = float(np.median(rough[wanted])) * (BEHIND + BEFORE) / TRIES
        return DepthMap(int(frames[k]), np.where(sure, found, 0).astype(np.float32), step)

    with ThreadPoolExecutor(torch.get_num_threads()) as pool:
        maps = {k: one for k, one in enumerate(pool.map(look, range(len(frames)))) if one is not None}
    keep_agreed(maps, K, poses, dict(enumerate(others)))
    points, frame, at = points_of(list(maps.values()), views)
    place = {int(i): k for k, i in enumerate(frames)}
    colors = np.stack(pictures)[[place[int(i)] for i in frame], at[:, 1].astype(int), at[:, 0].astype(int)] / 255.0
    empty, open_ = np.zeros(len(hull), bool), np.zeros(len(hull), bool)
    for k in range(len(frames)):
        pixel, depth, shown = _projected(K[k], poses[k], hull, size)
        x, y = pixel.T
        known = maps[k].inverse[y, x] if k in maps else np.zeros(len(shown), np.float32)
        empty[shown] |= (known > 0) & (depth * known < 1 - TOLERANCE)
        open_[shown] |= (known == 0) & (depth * nearest[k][y, x] < 1 + FRONT)
    return points, colors, open_ & ~empty


def _nearest(K: np.ndarray, pose: np.ndarray, points: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Inverse depth [h, w] of the nearest of ``points`` [P, 3] around each pixel, 0 where there is none."""
    pixel, depth, _ = _projected(K, pose, points, size)
    inverse = np.zeros((size[1], size[0]), np.float32)
    np.maximum.at(inverse, (pixel[:, 1], pixel[:, 0]), (1 / depth).astype(np.float32))
    return cv2.dilate(inverse, np.ones((SPLAT, SPLAT), np.uint8))


def _projected(K: np.ndarray, pose: np.ndarray, points: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels [n, 2] (x, y) and depths [n] of those of ``points`` [P, 3] that the image shows, and their indices [n]."""
    cam = points @ pose[:3, :3].T + pose[:3, 3]
    ahead = np.flatnonzero(cam[:, 2] > 1e-6)
    cam = cam[ahead]
    pixel = np.floor(cam[:, :2] / cam[:, 2:] * K[[0, 1], [0, 1]] + K[:2, 2])
    inside = ((pixel >= 0) & (pixel < size)).all(1)
    return pixel[inside].astype(int), cam[inside, 2], ahead[inside]
