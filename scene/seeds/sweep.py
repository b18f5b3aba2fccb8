"""Depth by plane sweep (Collins 1996): which of many parallel planes makes neighbouring pictures agree best, pixel by pixel.

Features say where corners are; this says where everything with a texture is. The measure is the zero-mean normalised cross-correlation, to
which the colour gains of cameras make no difference.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import torch

from ..views import Views

WIDTH = 320  # px, longest side of the pictures that are compared
NEIGHBOURS = 4  # cameras that each is compared with, of which
AGREEING = 2  # the best so many count: others may not see the place
NARROW, WIDE = 3.0, 45.0  # degrees between the directions from which two cameras see the scene
WINDOW = 7  # px, side of what is correlated
LEAST_SCORE = 0.75  # correlation from which a plane is believed
LEAD = 0.04  # of the best plane's score before those that are not beside it
TEXTURE = 2.0  # grey levels, standard deviation in a window below which nothing can be told
LEAST_POINTS = 8  # that a view must show to be looked at
PLANES = (32, 160)  # at least and at most; as many as make a step of one pixel
BEYOND = 1.3  # the sweep reaches so far beyond the nearest and farthest known points of a view
SAME = 1.5  # planes by which two depth maps may differ where they see the same


class DepthMap:
    """frame: its number. inverse [h, w] float32, 1 / world units, 0 where nothing is known. step: between two planes, in the same unit."""

    def __init__(self, frame: int, inverse: np.ndarray, step: float) -> None:
        self.frame, self.inverse, self.step = frame, inverse, step


def plane_sweep(
    views: Views, frames: Sequence[int], pictures: Sequence[np.ndarray], points: np.ndarray, advance: Callable[[int], None] = lambda n: None
) -> list[DepthMap]:
    """Depth of ``frames`` that see one scene at rest, of which ``pictures`` are uint8 [H, W, 3]; only where at least two of them agree.

    points [P, 3]: trusted points, world units; they say how near and how far to look. Frames that show none, or that have no other beside
    them at a fit angle, have no map.
    """
    scale = min(1.0, WIDTH / max(views.width, views.height))
    size = max(8, round(views.width * scale)), max(8, round(views.height * scale))
    grey = [cv2.cvtColor(cv2.resize(p, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY).astype(np.float32) for p in pictures]
    K = np.stack([np.diag([size[0] / views.width, size[1] / views.height, 1.0]) @ views.K[i] for i in frames])
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
    kept = {k: agreed(maps, K, poses, k, beside(views, frames, k, points)) for k in maps}
    for k, inverse in kept.items():
        maps[k].inverse = inverse
    return list(maps.values())


def beside(views: Views, frames: Sequence[int], k: int, points: np.ndarray) -> list[int]:
    """Places in ``frames`` of the cameras nearest to the k-th that see the middle of its points from another side."""
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
    """All that ``maps`` know: points [n, 3] in world units, and the frame [n] and pixel [n, 2] (x, y of the full picture) of each."""
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
    """Inverse depth [h, w] of the k-th picture, 0 where no plane stands out, and the step between planes."""
    h, w = grey[k].shape
    relative = [poses[j] @ np.linalg.inv(poses[k]) for j in others]
    middle = np.array([w / 2, h / 2, 1.0])
    ends = []
    for j, pose in zip(others, relative):
        ray = pose[:3, :3] @ np.linalg.inv(K[k]) @ middle
        at = [K[j] @ (ray * z + pose[:3, 3]) for z in (near, far)]
        ends.append(np.linalg.norm(at[0][:2] / at[0][2] - at[1][:2] / at[1][2]) if min(at[0][2], at[1][2]) > 0 else PLANES[1])
    count = int(np.clip(np.ceil(max(ends)), *PLANES))
    inverse = np.linspace(1 / far, 1 / near, count)
    blur = lambda image: cv2.boxFilter(image, -1, (WINDOW, WINDOW))  # noqa: E731
    mean = blur(grey[k])
    spread = np.sqrt(np.maximum(blur(grey[k] * grey[k]) - mean * mean, 0))
    # Pixel centres lie at +0.5, and OpenCV's at whole numbers.
    shift = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    scores = np.empty((count, h, w), np.float32)
    inside = np.ones((h, w), np.float32)
    for p, value in enumerate(inverse):
        each = np.full((len(others), h, w), -1.0, np.float32)
        for o, (j, pose) in enumerate(zip(others, relative)):
            plane = pose[:3, :3] + np.outer(pose[:3, 3], [0, 0, value])
            H = np.linalg.inv(shift) @ K[j] @ plane @ np.linalg.inv(K[k]) @ shift
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            there = cv2.warpPerspective(grey[j], H, (w, h), flags=flags)
            seen = cv2.warpPerspective(inside, H, (w, h), flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP) > 0
            their_mean = blur(there)
            their_spread = np.sqrt(np.maximum(blur(there * there) - their_mean * their_mean, 0))
            score = (blur(grey[k] * there) - mean * their_mean) / np.maximum(spread * their_spread, 1e-3)
            each[o] = np.where(seen & (their_spread > TEXTURE), score, -1.0)
        each.sort(axis=0)
        best = each[-AGREEING:]
        scores[p] = blur(best.mean(0))  # neighbours have a say: single pixels are right by chance
    choice = scores.argmax(0)
    rows = np.arange(count)[:, None, None]
    top = np.take_along_axis(scores, choice[None], 0)[0]
    rival = np.where(np.abs(rows - choice) > 2, scores, -1.0).max(0)
    sure = (top > LEAST_SCORE) & (top - rival > LEAD) & (spread > TEXTURE) & (choice > 0) & (choice < count - 1)
    before, after = (np.take_along_axis(scores, np.clip(choice + d, 0, count - 1)[None], 0)[0] for d in (-1, 1))
    bend = before - 2 * top + after
    offset = np.where(bend < -1e-6, 0.5 * (before - after) / np.where(bend < -1e-6, bend, -1.0), 0.0)
    step = float(inverse[1] - inverse[0])
    found = inverse[0] + (choice + np.clip(offset, -0.5, 0.5)) * step
    return np.where(sure, found, 0.0).astype(np.float32), step


def agreed(maps: dict[int, DepthMap], K: np.ndarray, poses: np.ndarray, k: int, others: list[int]) -> np.ndarray:
    """The inverse depth of the k-th map where at least one other map has the same place at the same depth, else 0."""
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
