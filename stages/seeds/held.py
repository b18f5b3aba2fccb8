"""Depth that came with the capture, as maps at which training holds what moves.

A guessed depth is not held: it is off by several percent, and holding it cost 0.15 to 0.7 dB of what moves (benchmarks/results/trials.md).
"""

from __future__ import annotations

import numpy as np

from ...vision.moving.followed_parts import Objects, inner
from ..depth.artifact import StoredDepth
from .depths import surface

UNSURE = 0.3  # confidence in a part of a mask of which nothing tells the depth
STEP = 2  # pixels of the labels for one of the map: depth is smooth, and all frames' maps are kept


def held_map(objects: Objects, depths: np.ndarray, K: np.ndarray, k: int, usual: float, given: StoredDepth, i: int) -> np.ndarray:
    """[2, h, w] float32 for frame ``k``, whose parts have ``depths`` [labels]: inverse depth, 1 / world units, 0 where nothing moves, and
    its confidence. The rim of each part is left out: masks extend onto what is behind. For the rest, see `depth_at`."""
    inside = inner(objects.labels[k])
    z = surface(objects, depths, K, k, usual, given, i)
    sure = np.where(depths[inside] > 0, 1.0, UNSURE)
    both = np.stack([np.where(inside > 0, 1 / z, 0.0), np.where(inside > 0, sure, 0.0)])
    return both[:, STEP // 2 :: STEP, STEP // 2 :: STEP].astype(np.float32)
