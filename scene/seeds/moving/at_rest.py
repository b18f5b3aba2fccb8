"""What masks of moving pixels hold besides what moves: the static scene around outlines, in gaps and between limbs.

Other frames saw it there uncovered. Their depth maps say where it lies in this frame, and their pictures how it looks. A seed on such a
pixel would stand at the depth of what moves, and hide from beside what is behind.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import cv2
import numpy as np

from ...views import Views

LOOKS = 16  # frames, the nearest in time, by which the static scene is known
FEWEST = 2  # least number of these that must show a pixel's place
SAME = 0.05  # share of the depth by which a frame's own map may differ at a place that it shows
WINDOW = 5  # px of the depth maps, side of the windows that are compared: a pixel counts if any of those around it looks alike,
KNOWN = 0.4  # with at least this share of its pixels known
ALIKE = 0.08  # difference of colours in [0, 1], of the channel that differs most, up to which a window looks alike,
ALONE = 1.5  # and times this for a pixel with its neighbours


class StaticScene:
    """The static scene as frames of moving cameras saw it. inverse: inverse depth by frame, [h, w] float32, 1 / world units, 0 where it is
    unknown or something moves; not empty."""

    def __init__(self, views: Views, inverse: Mapping[int, np.ndarray]) -> None:
        self._views, self._inverse = views, inverse
        self.height, self.width = next(iter(inverse.values())).shape
        y, x = np.mgrid[: self.height, : self.width].astype(np.float32) + 0.5
        self._pixels = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3)
        self._picture = lru_cache(2 * LOOKS)(self._small)

    def expected(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """How the static scene looks in frame ``i``, [h, w, 3] in [0, 1], and where at least `FEWEST` other frames show it, [h, w] bool."""
        own = self._views.time[i]
        others = sorted((f for f in self._inverse if f != i), key=lambda f: (abs(self._views.time[f] - own), f))[:LOOKS]
        if len(others) < FEWEST:
            return np.zeros((self.height, self.width, 3), np.float32), np.zeros((self.height, self.width), bool)
        places = self._lifted(i, self._depth(i, others))
        looks = [self._seen(f, places) for f in others]
        known = np.sum([there for _, there in looks], 0) >= FEWEST
        colours = np.stack([np.where(there[..., None], colour, np.nan) for colour, there in looks])
        with np.errstate(all="ignore"):
            colour = np.nan_to_num(np.nanmedian(np.where(known[..., None], colours, 0), 0))
        return colour, known

    def shown(self, i: int) -> np.ndarray:
        """[h, w] bool: the pixels of frame ``i`` that look like the static scene; False where nothing else shows it."""
        colour, known = self.expected(i)
        off = np.where(known, np.abs(self._picture(i) - colour).max(-1), 0).astype(np.float32)
        window, alone = self._mean(off, known, WINDOW), self._mean(off, known, 3)
        nearby = cv2.erode(window, np.ones((WINDOW, WINDOW), np.uint8))
        return np.asarray(known & (nearby < ALIKE) & (alone < ALONE * ALIKE))

    def _small(self, i: int) -> np.ndarray:
        size = self.width, self.height
        return np.asarray(cv2.resize(self._views.load(i), size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255)

    def _intrinsics(self, i: int) -> np.ndarray:
        return np.diag([self.width / self._views.width, self.height / self._views.height, 1.0]) @ self._views.K[i]

    def _lifted(self, i: int, depth: np.ndarray) -> np.ndarray:
        """World positions [h * w, 3] of the pixels of frame ``i`` at ``depth`` [h * w]."""
        pose = self._views.cam_from_world[i]
        return ((self._pixels @ np.linalg.inv(self._intrinsics(i)).T) * depth[:, None] - pose[:3, 3]) @ pose[:3, :3]

    def _projected(self, i: int, places: np.ndarray) -> np.ndarray:
        """[n, 3]: x and y, px of the maps, and depth of world positions ``places`` [n, 3] in frame ``i``."""
        pose = self._views.cam_from_world[i]
        seen = places @ pose[:3, :3].T + pose[:3, 3]
        depth = seen[:, 2:]
        return np.concatenate([(seen @ self._intrinsics(i).T)[:, :2] / np.where(depth > 0, depth, np.nan), depth], 1)

    def _depth(self, i: int, others: list[int]) -> np.ndarray:
        """Depth [h * w] of the nearest static surface at the pixels of frame ``i`` by maps of ``others``; very far where none is known."""
        found = []
        for f in others:
            inverse = self._inverse[f].reshape(-1)
            there = inverse > 0
            depth = 1 / np.where(there, inverse, 1)
            found.append(self._projected(i, self._lifted(f, depth)[there]))
        x, y, z = np.concatenate(found).T
        ahead = (z > 0) & (x >= 0) & (y >= 0) & (x < self.width) & (y < self.height)
        x, y, z = x[ahead].astype(int), y[ahead].astype(int), z[ahead]
        farthest_first = np.argsort(-z, kind="stable")
        depth = np.zeros((self.height, self.width), np.float32)
        depth[y[farthest_first], x[farthest_first]] = z[farthest_first]
        around = cv2.medianBlur(depth, 3)  # closes gaps between the points
        depth = np.where(depth > 0, depth, around).reshape(-1)
        return np.where(depth > 0, depth, np.float32(1e6))

    def _seen(self, f: int, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The colours [h, w, 3] that frame ``f`` shows at ``places`` [h * w, 3], and whether it shows them, [h, w] bool."""
        x, y, z = self._projected(f, places).astype(np.float32).T.reshape(3, self.height, self.width)
        x, y = np.nan_to_num(x - 0.5, nan=-9.0), np.nan_to_num(y - 0.5, nan=-9.0)
        colour = cv2.remap(self._picture(f), x, y, cv2.INTER_LINEAR)
        inverse = cv2.remap(self._inverse[f], x, y, cv2.INTER_NEAREST)
        return colour, (inverse > 0) & (np.abs(inverse * z - 1) < SAME)

    @staticmethod
    def _mean(values: np.ndarray, known: np.ndarray, side: int) -> np.ndarray:
        """Mean of ``values`` [h, w] over the ``known`` pixels of windows of ``side`` px; 1 where too few of them are."""
        share = cv2.blur(known.astype(np.float32), (side, side))
        return np.where(share >= KNOWN, cv2.blur(values, (side, side)) / np.maximum(share, 1e-6), np.float32(1))
