"""Depth by plane sweep (Collins 1996): for each pixel, the one of many parallel planes that makes neighbouring images agree best. Then each
pixel looks for the slanted plane that does (`slanted`).

Feature matching finds only corners; the sweep finds everything that has texture. The measure is zero-mean normalised cross-correlation,
which does not depend on the cameras' colour gains.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import torch

from ..views import Views
from .slanted import refine

WIDTH = 320  # px, longest side of the images that are compared
NEIGHBOURS = 4  # cameras that each one is compared with
AGREEING = 2  # of these, how many count, the best ones: the others may not see the place
NARROW, WIDE = 3.0, 45.0  # degrees between the directions from which two cameras see the scene
WINDOW = 7  # px, side of the correlation window
LEAST_SCORE = 0.75  # least correlation of an accepted plane
TEXTURE = 2.0  # grey levels; windows with a smaller standard deviation have too little texture
LEAST_POINTS = 8  # views that show fewer get no map
PLANES = (32, 160)  # fewest and most planes; in between, as many as make a step about one pixel
BEYOND = 1.3  # factor by which the sweep extends beyond the nearest and farthest known points of a view
SAME = 1.5  # number of plane steps by which two maps may differ and still agree


class DepthMap:
    """frame: its number. inverse [h, w] float32, 1 / world units, 0 where unknown. step: distance between two planes, in the same unit."""

    def __init__(self, frame: int, inverse: np.ndarray, step: float) -> None:
        self.frame, self.inverse, self.step = frame, inverse, step


def plane_sweep(
    views: Views, frames: Sequence[int], pictures: Sequence[np.ndarray], points: np.ndarray, advance: Callable[[int], None] = lambda n: None
) -> list[DepthMap]:
    """Depth maps of ``frames`` that see one static scene, where at least two frames agree. pictures: their images, uint8 [H, W, 3].

    points [P, 3]: trusted points in world units, which set the range of depths. Frames that show too few of them, or that have no other
    frame at a suitable angle, get no map.
    """
    grey, K = small_pictures(views, frames, pictures)
    poses = views.cam_from_world[list(frames)]

    def look(k: int) -> tuple[int, np.ndarray, float] | None:
        depth = views.project(int(frames[k]), points).depth
        others = beside(views, frames, k, points)
        advance(1)
        if len(depth) < LEAST_POINTS or not len(others):
            return None
        near, far = np.quantile(depth, 0.01) / BEYOND, np.quantile(depth, 0.99) * BEYOND
        return k, *_sweep(grey, K, poses, k, others, near, far)

    with ThreadPoolExecutor(torch.get_num_threads()) as pool:
        rough = [found for found in pool.map(look, range(len(frames))) if found is not None]
    maps = {k: DepthMap(int(frames[k]), inverse, step) for k, inverse, step in rough}
    keep_agreed(maps, K, poses, {k: beside(views, frames, k, points) for k in maps})
    return list(maps.values())


def small_pictures(views: Views, frames: Sequence[int], pictures: Sequence[np.ndarray]) -> tuple[list[np.ndarray], np.ndarray]:
    """The ``pictures`` in grey, [h, w] float32, at the size at which they are compared, and the K [n, 3, 3] of ``frames`` there, px."""
    scale = min(1.0, WIDTH / max(views.width, views.height))
    size = max(8, round(views.width * scale)), max(8, round(views.height * scale))
    grey = [cv2.cvtColor(cv2.resize(p, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY).astype(np.float32) for p in pictures]
    return grey, np.stack([np.diag([size[0] / views.width, size[1] / views.height, 1.0]) @ views.K[i] for i in frames])


def towards(others: list[int], K: np.ndarray, poses: np.ndarray, k: int) -> np.ndarray:
    """[N, 3, 4]: the pixel (x, y) of the k-th image with inverse depth v lies at this times (x, y, 1, v) in each of ``others``, times its
    depth there."""
    relative = [poses[j] @ np.linalg.inv(poses[k]) for j in others]
    return np.stack([K[j] @ np.hstack([pose[:3, :3] @ np.linalg.inv(K[k]), pose[:3, 3:]]) for j, pose in zip(others, relative)])


def beside(views: Views, frames: Sequence[int], k: int, points: np.ndarray) -> list[int]:
    """Positions in ``frames`` of the cameras that see the middle of the k-th one's points from suitable angles, nearest in angle first."""
    shown = views.project(int(frames[k]), points).point
    if not len(shown):
        return []
    target = np.median(points[shown], axis=0)
    rays = target - views.centres()[list(frames)]
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
    angle = np.degrees(np.arccos(np.clip(rays @ rays[k], -1, 1)))
    fit = [j for j in np.argsort(angle) if j != k and NARROW <= angle[j] <= WIDE]
    return [int(j) for j in fit[:NEIGHBOURS]]


def points_of(maps: Sequence[DepthMap], views: Views) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All known depths of ``maps`` as points [n, 3] in world units, with the frame [n] and pixel [n, 2] (x, y at full size) of each."""
    found = []
    for one in maps:
        h, w = one.inverse.shape
        y, x = np.nonzero(one.inverse)
        at = (np.stack([x, y], 1) + 0.5) * [views.width / w, views.height / h]
        K, pose = views.K[one.frame], views.cam_from_world[one.frame]
        ray = np.concatenate([(at - K[:2, 2]) / K[[0, 1], [0, 1]], np.ones((len(at), 1))], 1)
        world = (ray / one.inverse[y, x][:, None] - pose[:3, 3]) @ pose[:3, :3]
        found.append((world, np.full(len(at), one.frame), at))
    if not found:
        return np.zeros((0, 3)), np.zeros(0, int), np.zeros((0, 2))
    world, frame, at = (np.concatenate(parts) for parts in zip(*found))
    return world, frame, at


def _sweep(
    grey: list[np.ndarray], K: np.ndarray, poses: np.ndarray, k: int, others: list[int], near: float, far: float
) -> tuple[np.ndarray, float]:
    """Inverse depth [h, w] of the k-th image, 0 where no plane makes the others agree, and the step between planes."""
    h, w = grey[k].shape
    to = towards(others, K, poses, k)
    ends = []
    for one in to:
        at = [one @ [w / 2, h / 2, 1, 1 / z] for z in (near, far)]
        ahead = min(at[0][2], at[1][2]) > 0
        ends.append(np.linalg.norm(at[0][:2] / at[0][2] - at[1][:2] / at[1][2]) if ahead else PLANES[1])
    count = int(np.clip(np.ceil(max(ends)), *PLANES))
    inverse = np.linspace(1 / far, 1 / near, count)
    blur = lambda image: cv2.boxFilter(image, -1, (WINDOW, WINDOW))  # noqa: E731
    mean = blur(grey[k])
    spread = np.sqrt(np.maximum(blur(grey[k] * grey[k]) - mean * mean, 0))
    # Pixel centres are at +0.5 here, but at whole numbers in OpenCV.
    shift = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    inside = np.ones((h, w), np.float32)
    best, rough = np.full((h, w), -np.inf, np.float32), np.zeros((h, w), np.float32)
    for value in inverse:
        each = np.full((len(others), h, w), -1.0, np.float32)
        for o, j in enumerate(others):
            H = np.linalg.inv(shift) @ (to[o][:, :3] + np.outer(to[o][:, 3], [0, 0, value])) @ shift
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            there = cv2.warpPerspective(grey[j], H, (w, h), flags=flags)
            seen = cv2.warpPerspective(inside, H, (w, h), flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP) > 0
            their_mean = blur(there)
            their_spread = np.sqrt(np.maximum(blur(there * there) - their_mean * their_mean, 0))
            score = (blur(grey[k] * there) - mean * their_mean) / np.maximum(spread * their_spread, 1e-3)
            each[o] = np.where(seen & (their_spread > TEXTURE), score, -1.0)
        each.sort(axis=0)
        score = blur(each[-AGREEING:].mean(0))  # averaged over neighbours, as single pixels may match by chance
        better = score > best
        best[better], rough[better] = score[better], value
    found, score = refine(grey[k], [grey[j] for j in others], to, AGREEING, rough, (inverse[0], inverse[-1]), count, K[k][0, 0])
    sure = (score > LEAST_SCORE) & (spread > TEXTURE) & (found > inverse[0]) & (found < inverse[-1])
    return np.where(sure, found, 0.0).astype(np.float32), float(inverse[1] - inverse[0])


def keep_agreed(maps: dict[int, DepthMap], K: np.ndarray, poses: np.ndarray, others: dict[int, list[int]]) -> None:
    """Forgets the depths in ``maps`` that none of the maps of ``others`` confirms. All are compared before any changes."""
    kept = {k: agreed(maps, K, poses, k, others[k]) for k in maps}
    for k, inverse in kept.items():
        maps[k].inverse = inverse


def agreed(maps: dict[int, DepthMap], K: np.ndarray, poses: np.ndarray, k: int, others: list[int]) -> np.ndarray:
    """The inverse depth of the k-th map where at least one other map agrees on the place, else 0."""
    own = maps[k].inverse
    h, w = own.shape
    y, x = np.nonzero(own)
    ray = np.stack([x + 0.5, y + 0.5, np.ones(len(x))], 1) @ np.linalg.inv(K[k]).T
    world = (ray / own[y, x][:, None] - poses[k, :3, 3]) @ poses[k, :3, :3]
    votes = np.zeros(len(x), int)
    for j in others:
        if j not in maps:
            continue
        cam = world @ poses[j, :3, :3].T + poses[j, :3, 3]
        z = np.where(cam[:, 2] > 1e-9, cam[:, 2], np.inf)
        u, v = (np.floor(K[j, c, c] * cam[:, c] / z + K[j, c, 2]) for c in (0, 1))
        there = np.isfinite(z) & (u >= 0) & (u < w) & (v >= 0) & (v < h)
        theirs = maps[j].inverse[np.where(there, v, 0).astype(int), np.where(there, u, 0).astype(int)]
        votes += there & (theirs > 0) & (np.abs(theirs - 1 / z) < SAME * maps[j].step)
    out = np.zeros_like(own)
    out[y[votes > 0], x[votes > 0]] = own[y[votes > 0], x[votes > 0]]
    return out
