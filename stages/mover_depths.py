"""How far away something is that moves by itself: not told by one moving camera, but bounded by the still points that it hides.

What stands on the floor hides the floor up to its feet, so the nearest hidden point is not far behind it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..scene.views import Views

NEAR = 5.0  # percentile of the depths of hidden points that counts as the nearest: single points may be wrong
FEWEST = 5  # hidden points that tell a depth
BEFORE = 0.97  # of that depth: what hides is in front of what is hidden
INSET = 0.01  # of the picture's width; masks reach over outlines by as much, onto nearer floor
STEADY = 9  # frames over which a track's depth is a median


def component_depths(mask: np.ndarray, views: Views, i: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Connected parts of ``mask`` [H, W] bool of frame ``i``: labels [H, W] int32, and the depth of each label in world units, 0 where the
    still ``points`` [P, 3] do not tell (and for label 0, which is what does not move)."""
    import cv2

    inset = max(1, round(INSET * mask.shape[1]))
    labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)[1]
    inner = np.where(cv2.erode(mask.astype(np.uint8), np.ones((2 * inset + 1, 2 * inset + 1), np.uint8)) > 0, labels, 0)
    _, x, y, z = views.project(i, points)
    hit = inner[y, x]
    depths = np.zeros(int(labels.max()) + 1, np.float32)
    for label in range(1, len(depths)):
        hidden = z[hit == label]
        if len(hidden) >= FEWEST:
            depths[label] = BEFORE * np.percentile(hidden, NEAR)
    return labels, depths


def depth_at(components: tuple[np.ndarray, np.ndarray], places: np.ndarray, usual: float) -> np.ndarray:
    """Depth [n] of pixels ``places`` [n, 2]; ``usual`` where their part tells none."""
    labels, depths = components
    height, width = labels.shape
    x, y = (np.clip(places[:, c], 0, size - 1).astype(int) for c, size in ((0, width), (1, height)))
    z = depths[labels[y, x]]
    return np.where(z > 0, z, usual)


def steady(depth: np.ndarray, alive: np.ndarray) -> np.ndarray:
    """``depth`` [F, n] as a moving median over the `STEADY` frames around, of those in which the track is ``alive`` [F, n]."""
    values = np.where(alive, depth, np.nan)
    half = STEADY // 2
    padded = np.pad(values, ((half, half), (0, 0)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, STEADY, axis=0)
    order = np.sort(windows, axis=-1)  # NaN goes last
    count = np.isfinite(order).sum(-1)
    middle = np.take_along_axis(order, np.maximum(count - 1, 0)[..., None] // 2, axis=-1)[..., 0]
    return np.where(count > 0, middle, depth)
