"""Chains the flow of one camera from frame to frame, to track pixels of moving objects for as long as flow is reliable."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple, Protocol

import cv2
import numpy as np

from ..images.pictures import shrunk
from .two_way import consistency

TRUSTED = 64  # of 255; a track ends where the confidence is not above this
SIZE = 480  # px, longest side at which steps are cached: flow is smooth, and so each step is read only once for all tracks
KEPT = 512  # steps of 0.6 MB, and as many masks of 0.1 MB, in memory


class PairwiseFlow(Protocol):
    """Flow of P pairs of frames of H x W px, and masks of moving pixels, read one at a time."""

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """P pairs: a frame and the same camera's next frame."""
        ...

    @property
    def size(self) -> tuple[int, int]:
        """(H, W)."""
        ...

    def forward(self, p: int) -> np.ndarray:
        """Flow of pair ``p``, [H, W, 2] px: u to the right, v down."""
        ...

    def backward(self, p: int) -> np.ndarray:
        """Flow from the second frame of pair ``p`` to the first, [H, W, 2] px."""
        ...

    def confidence(self, p: int) -> np.ndarray:
        """uint8 [H, W]: 255 where both directions of pair ``p`` agree."""
        ...

    def moving(self, frame: int) -> np.ndarray:
        """uint8 [H, W]: 255 where a frame shows something that moves."""
        ...


class Step(NamedTuple):
    """flow [h, w, 2] float16, in px of the full picture; confidence [h, w] uint8."""

    flow: np.ndarray
    confidence: np.ndarray


class Chain:
    """Flow of one camera between consecutive ``frames``, and its masks of moving pixels, read on demand. Positions are in pixels of the
    full pictures, with pixel centres at whole numbers."""

    def __init__(self, flow: PairwiseFlow, frames: list[int]) -> None:
        pairs = {pair: p for p, pair in enumerate(flow.pairs)}
        self._pair = [pairs.get((a, b)) for a, b in pairwise(frames)]
        self._flow, self._frames = flow, frames
        self.height, self.width = flow.size
        self._step = lru_cache(maxsize=KEPT)(self._read_step)
        self._small_mask = lru_cache(maxsize=KEPT)(self._read_small_mask)

    def mask(self, k: int) -> np.ndarray:
        """bool [H, W]: moving pixels in frame ``k`` of the sequence."""
        return self._flow.moving(self._frames[k]) > 127

    def small_mask(self, k: int) -> np.ndarray:
        """`mask` at `SIZE` px: bool [h, w]."""
        return self._small_mask(k) > 127

    def follow(self, start: int, begin: np.ndarray, most: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Tracks pixels ``begin`` [n, 2] of frame ``start``: their positions in each frame, [F, n, 2] px, and whether each track still
        holds there, bool [F, n]; for at most ``most`` frames to either side."""
        count, n = len(self._frames), len(begin)
        places, alive = np.tile(begin.astype(np.float32), (count, 1, 1)), np.zeros((count, n), bool)
        alive[start] = True
        for direction in (1, -1):
            k = start
            while 0 <= k + direction < count and alive[k].any() and (most is None or abs(k + direction - start) <= most):
                moved = self.move(k, direction, places[k])
                if moved is None:
                    break
                places[k + direction], trusted = moved
                alive[k + direction] = alive[k] & trusted
                k += direction
        return places, alive

    def move(self, k: int, direction: int, places: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Positions [n, 2] px of pixels ``places`` [n, 2] of frame ``k`` in the next (1) or previous (-1) frame, and whether their flow is
        trusted and ends on a mask, [n] bool; None if flow was not measured."""
        step = self._step(k, direction)
        if step is None:
            return None
        places = np.ascontiguousarray(places, np.float32)
        if not len(places):
            return places, np.zeros(0, bool)
        confidence = self._sample(step.confidence.astype(np.float32), places)
        moved = places + self._sample(step.flow.astype(np.float32), places)
        inside = self._sample(self._small_mask(k + direction).astype(np.float32), moved, outside=0.0) > 127
        return moved, (confidence > TRUSTED) & inside

    def _read_step(self, k: int, direction: int) -> Step | None:
        """Flow from frame ``k`` to the next (1) or previous (-1) frame; None if it was not measured."""
        p = self._pair[k if direction > 0 else k - 1]
        if p is None:
            return None
        if direction > 0:
            return Step(self._small(self._flow.forward(p)), self._small(self._flow.confidence(p)))
        back, forth = self._flow.backward(p).astype(np.float32), self._flow.forward(p).astype(np.float32)
        return Step(self._small(back), self._small(consistency(back, forth)))

    def _read_small_mask(self, k: int) -> np.ndarray:
        return self._small(self._flow.moving(self._frames[k]))

    def _small(self, values: np.ndarray) -> np.ndarray:
        """Flow, confidence or a mask [H, W, ...] scaled down to `SIZE`: float16, or uint8 for uint8."""
        reduced = shrunk(values.astype(np.float32), SIZE)
        return np.rint(reduced).astype(np.uint8) if values.dtype == np.uint8 else reduced.astype(np.float16)

    def _sample(self, values: np.ndarray, places: np.ndarray, outside: float | None = None) -> np.ndarray:
        """``values`` [h, w] or [h, w, 2] float32 at ``places`` [n, 2], bilinear. Outside the picture: its border value, or ``outside``."""
        small_height, small_width = values.shape[:2]
        x = (places[:, :1] + 0.5) * np.float32(small_width / self.width) - 0.5
        y = (places[:, 1:] + 0.5) * np.float32(small_height / self.height) - 0.5
        border = {"borderMode": cv2.BORDER_REPLICATE} if outside is None else {"borderMode": cv2.BORDER_CONSTANT, "borderValue": outside}
        return cv2.remap(values, x, y, cv2.INTER_LINEAR, **border)[:, 0]
