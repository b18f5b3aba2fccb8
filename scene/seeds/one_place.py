"""What a camera that stands still sees of the static scene: its background without what passes, and an assumed depth of it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...pipeline.choice.evenly import evenly
from ..views import Views

LOOKS = 31  # pictures of which the background is the median
ROWS = 64  # of a picture at once, which bounds the memory
DISTANCE = 4.0  # world units to the wall, or the median of given depth: what structure from motion makes the usual distance
FOOT = 0.35  # of the way from the horizon to the bottom border: where the floor meets the wall


def background(views: Views, unsteady: Callable[[int], np.ndarray | None]) -> np.ndarray:
    """uint8 [H, W, 3]: the median over time of the pixels that show the static scene, or of all where none ever does.

    unsteady(i): [H, W] bool, pixels of frame i that show something else; None: none do."""
    looks = evenly(views.train, LOOKS)
    pictures, masks = [views.load(int(i)) for i in looks], [unsteady(int(i)) for i in looks]
    result = np.empty_like(pictures[0])
    for top in range(0, views.height, ROWS):
        part = np.s_[top : top + ROWS]
        seen = np.stack([one[part] for one in pictures]).astype(np.int16)
        other = np.stack([np.zeros(seen.shape[1:3], bool) if mask is None else mask[part] for mask in masks])
        other &= ~other.all(axis=0)
        seen[other] = 256  # sorts after every colour
        seen.sort(axis=0)
        count = (~other).sum(axis=0)
        low, high = ((count - 1) // 2)[None, ..., None], (count // 2)[None, ..., None]
        middle = np.take_along_axis(seen, low, axis=0)[0] + np.take_along_axis(seen, high, axis=0)[0]
        result[part] = (middle // 2).astype(np.uint8)
    return result


def assumed_depth(K: np.ndarray, width: int, height: int) -> np.ndarray:
    """[H, W] float32, world units along the optical axis: a wall at `DISTANCE`, and a level floor from its foot to the camera.

    The camera is taken to be level, so that the horizon is at the principal point. K [3, 3] px."""
    horizon = min(max(float(K[1, 2]), 0.0), height - 1.0)
    below = (np.arange(height) + 0.5 - horizon) / (height - horizon)  # 0 at the horizon, 1 at the bottom border
    depth = DISTANCE * np.minimum(1.0, FOOT / np.maximum(below, 1e-6))
    return np.repeat(depth[:, None], width, axis=1).astype(np.float32)
