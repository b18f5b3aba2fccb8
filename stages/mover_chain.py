"""Flow of one camera chained from frame to frame: where pixels of something that moves go, and how long they can be followed."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from .optical_flow import consistency

if TYPE_CHECKING:
    from ..pipeline import Artifact

TRUSTED = 64  # of 255, confidence down to which a track goes on


class Chain:
    """Flow of one camera from frame to frame of ``frames``, and its masks of movers, read as needed."""

    def __init__(self, flow: Artifact, frames: list[int]) -> None:
        pairs = {(int(a), int(b)): p for p, (a, b) in enumerate(flow.read("pair"))}
        self._pair = [pairs.get((a, b)) for a, b in pairwise(frames)]
        self._flow, self._frames = flow, frames
        self._step = lru_cache(maxsize=64)(self._read_step)  # tracks of neighbouring starts read the same steps

    def mask(self, k: int) -> np.ndarray:
        """bool [H, W]: what moves in frame ``k`` of the sequence."""
        return np.asarray(self._flow.array("movers")[self._frames[k]]) > 127

    def follow(self, start: int, begin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where pixels ``begin`` [n, 2] of frame ``start`` are in each frame, [F, n, 2] px, and how long they can be followed, [F, n]."""
        count, n = len(self._frames), len(begin)
        places, alive = np.tile(begin.astype(np.float32), (count, 1, 1)), np.zeros((count, n), bool)
        alive[start] = True
        for direction in (1, -1):
            k = start
            while 0 <= k + direction < count and alive[k].any():
                step = self._step(k, direction)
                if step is None:
                    break
                moved, confidence = sample(step[0], places[k]), sample(step[1].astype(np.float32), places[k])
                places[k + direction] = places[k] + moved
                inside = sample(self.mask(k + direction).astype(np.float32), places[k + direction], outside=0.0) > 0.5
                alive[k + direction] = alive[k] & (confidence > TRUSTED) & inside
                k += direction
        return places, alive

    def _read_step(self, k: int, direction: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Flow [H, W, 2] and its confidence [H, W] from frame ``k`` to the next (1) or the last (-1); None where it was not measured."""
        p = self._pair[k if direction > 0 else k - 1]
        if p is None:
            return None
        if direction > 0:
            return np.asarray(self._flow.array("forward")[p]).astype(np.float32), np.asarray(self._flow.array("confidence")[p])
        back, forth = (np.asarray(self._flow.array(name)[p]).astype(np.float32) for name in ("backward", "forward"))
        return back, consistency(back, forth)


def sample(values: np.ndarray, places: np.ndarray, outside: float | None = None) -> np.ndarray:
    """``values`` [H, W] or [H, W, 2] float32 at ``places`` [n, 2], bilinearly; beyond the picture its border, or ``outside``."""
    import cv2

    x, y = (np.ascontiguousarray(places[:, c : c + 1], np.float32) for c in (0, 1))
    border = {"borderMode": cv2.BORDER_REPLICATE} if outside is None else {"borderMode": cv2.BORDER_CONSTANT, "borderValue": outside}
    return cv2.remap(values, x, y, cv2.INTER_LINEAR, **border)[:, 0]
