"""Where things that move are over time, before any training: flow of their pixels chained to tracks, and lifted to where they can be.

Each connected part of a mask is taken to be as far away as the nearest still point that it hides (`mover_depths.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .mover_chain import Chain
from .mover_depths import component_depths, depth_at, steady
from .sequences import camera_sequences

if TYPE_CHECKING:
    from ..pipeline import Artifact
    from ..scene.views import Views

MOST = 2000  # tracks that begin in one frame
FEWEST_FRAMES = 3  # of a camera, for a path
STARTS = 7  # frames of a camera in which tracks begin


@dataclass(frozen=True)
class Tracks:
    """rest [N, 3] world units, at the middle time; colors [N, 3] in [0, 1]; times [T] in [0, 1]; positions [T, N, 3] world units; alive
    [T, N] bool: where a position is known."""

    rest: np.ndarray
    colors: np.ndarray
    times: np.ndarray
    positions: np.ndarray
    alive: np.ndarray


def mover_tracks(flow: Artifact, views: Views, points: np.ndarray, advance: Callable[[int], None] = lambda n: None) -> Tracks | None:
    """Tracks of what moves before all moving cameras of a capture; None where masks show nothing, or hide nothing that tells a depth.

    points [P, 3]: what stands still, for the most part. The rest position of a track that does not reach the middle time is carried there
    by the nearest track that does. advance: called with the number of frames that are done; every training frame counts once.
    """
    kept = []
    for frames in camera_sequences(views.camera, views.time, views.train).values():
        one = camera_tracks(flow, views, frames, points) if len(frames) >= FEWEST_FRAMES else None
        kept += [one] if one is not None else []
        advance(len(frames))
    if not kept:
        return None
    times = np.unique(views.time[views.train])
    rest, colors = (np.concatenate([getattr(one, name) for one in kept]) for name in ("rest", "colors"))
    positions = np.zeros((len(times), len(rest), 3), np.float32)
    alive = np.zeros((len(times), len(rest)), bool)
    start = 0
    for one in kept:
        rows = np.searchsorted(times, one.times)
        end = start + len(one.rest)
        positions[rows, start:end], alive[rows, start:end] = one.positions, one.alive
        start = end
    return Tracks(rest, colors, times, positions, alive)


def camera_tracks(flow: Artifact, views: Views, frames: list[int], points: np.ndarray) -> Tracks | None:
    """`mover_tracks` of one camera, whose ``frames`` are in order of time."""
    chain = Chain(flow, frames)
    depths = [component_depths(chain.mask(k), views, i, points) for k, i in enumerate(frames)]
    known = [float(np.median(values[values > 0])) for _, values in depths if (values > 0).any()]
    if not known:
        return None
    count, middle, usual = len(frames), len(frames) // 2, float(np.median(known))
    starts = sorted({round(s) for s in np.linspace(0, count - 1, min(STARTS, count))} | {middle}, key=lambda k: (abs(k - middle), k))
    places = np.zeros((count, 0, 2), np.float32)
    alive = np.zeros((count, 0), bool)
    world = np.zeros((count, 0, 3), np.float32)
    rest, colors = np.zeros((0, 3), np.float32), np.zeros((0, 3))
    for k in starts:
        begin = _uncovered(chain.mask(k), places[k][alive[k]])
        if not len(begin):
            continue
        x, there = chain.follow(k, begin)
        z = np.stack([depth_at(depths[j], x[j], usual) for j in range(count)])
        p = np.stack([lift(views, i, x[j], z_j) for j, (i, z_j) in enumerate(zip(frames, steady(z, there)))])
        home = p[k] if k == middle else p[k] + _carried(x[k], places[k], alive[k], rest - world[k])
        places, alive = np.concatenate([places, x], 1), np.concatenate([alive, there], 1)
        world, rest = np.concatenate([world, p], 1), np.concatenate([rest, home])
        picture = views.load(frames[k])
        colors = np.concatenate([colors, picture[begin[:, 1].astype(int), begin[:, 0].astype(int)] / 255.0])
    if not len(rest):
        return None
    return Tracks(rest, colors, views.time[frames], world, alive)


def _uncovered(mask: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Pixels [n, 2] (x, y) on a grid over ``mask`` [H, W] bool beside which no track of ``places`` [m, 2] runs."""
    import cv2

    stride = max(1, int(np.ceil(np.sqrt(max(mask.sum(), 1) / MOST))))
    free = np.ones(mask.shape, np.uint8)
    height, width = mask.shape
    x, y = np.floor(places).astype(int).T if len(places) else np.zeros((2, 0), int)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    free[y[inside], x[inside]] = 0
    alone = cv2.erode(free, np.ones((4 * stride + 1, 4 * stride + 1), np.uint8), borderValue=1) > 0
    grid = np.zeros(mask.shape, bool)
    grid[stride // 2 :: stride, stride // 2 :: stride] = True
    ys, xs = np.nonzero(mask & grid & alone)
    return np.stack([xs, ys], 1).astype(np.float32)


def _carried(places: np.ndarray, others: np.ndarray, alive: np.ndarray, back: np.ndarray) -> np.ndarray:
    """What brings pixels ``places`` [n, 2] home: ``back`` [m, 3] of the nearest ``alive`` [m] one of ``others`` [m, 2]; 0 without any."""
    from scipy.spatial import cKDTree

    if not alive.any():
        return np.zeros((len(places), 3), np.float32)
    nearest = cKDTree(others[alive]).query(places)[1]
    return back[alive][nearest]


def lift(views: Views, i: int, places: np.ndarray, z: np.ndarray) -> np.ndarray:
    """World positions [n, 3] of pixels ``places`` [n, 2] (centres at +0.5) of frame ``i`` at depths ``z`` [n]."""
    K, pose = views.K[i], views.cam_from_world[i]
    ray = np.stack([(places[:, 0] + 0.5 - K[0, 2]) / K[0, 0], (places[:, 1] + 0.5 - K[1, 2]) / K[1, 1], np.ones(len(places))], 1)
    return ((ray * z[:, None] - pose[:3, 3]) @ pose[:3, :3]).astype(np.float32)
