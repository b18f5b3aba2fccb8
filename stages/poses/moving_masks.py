"""Detects moving pixels in the pictures, using the poses of the first pass of structure from motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import cv2
import numpy as np

from ...vision.flow.method import Dis
from ...vision.flow.two_way import FlowPair, consistency
from ...vision.images.lenses import undistort_maps
from ...vision.images.pictures import composite, resize, size_within, undistort
from ...vision.moving.moving_masks import moving_masks
from ...vision.sequences import camera_sequences
from ...vision.sfm.coverage import runs
from ..shared.frameset import FrameSet

SIZE = 320  # px, longest side at which flow and masks are computed; features need positions, not exact outlines
FEWEST = 6  # least number of frames of a camera; a frame is judged by up to four frames on either side
FOLLOWED = 0.6  # share of the picture that must have consistent flow for the flow to be trusted
REACH = 6  # pictures on either side that are cached while their neighbours are judged


def lens_moving_masks(
    frames: FrameSet,
    K: np.ndarray,
    cam_from_world: np.ndarray,
    distortion: np.ndarray,
    size: np.ndarray,
    advance: Callable[[], None],
    doubtful: np.ndarray | None = None,
) -> np.ndarray:
    """Masks of moving pixels in the pictures on which features were found (with lens distortion): bool [F, h, w], longest side `SIZE`.

    K [F, 3, 3] px and distortion [F, 4] fit pictures of `size` [F, 2] (width, height) px; cam_from_world [F, 4, 4]; NaN without a pose.
    doubtful [F] bool: frames whose poses are not used, because they may follow what moves; there, flow alone tells what moves.
    DIS measures flow between frames in order of time; pairs without reliable flow are left out. Nothing is masked in frames
    without a pose, without neighbours that have one, or of cameras with fewer than `FEWEST` frames. `advance()` is called once per frame.
    """
    width, height = size_within(frames.width, frames.height, SIZE)
    small = np.array(K, np.float64)
    small[:, 0] *= width / np.maximum(size[:, :1], 1)
    small[:, 1] *= height / np.maximum(size[:, 1:], 1)
    masks = np.zeros((len(frames), height, width), bool)
    for mine in camera_sequences(frames.camera, frames.time).values():
        if len(mine) >= FEWEST and np.isfinite(cam_from_world[mine]).all((1, 2)).sum() >= 2:
            lens = _Lens(small[mine], distortion[mine], width, height)
            picture = lru_cache(maxsize=2 * REACH)(lambda k, mine=mine, lens=lens: lens.pinhole(_small(frames, mine[k], width, height)))
            pairs = _Pairs(picture, len(mine) - 1)
            aside = np.zeros(len(mine), bool) if doubtful is None else doubtful[mine]
            trusted = np.where(aside[:, None, None], np.nan, cam_from_world[mine])
            for k, mask in enumerate(moving_masks(picture, pairs, small[mine], trusted)):
                masks[mine[k]] = lens.seen(mask) > 0
                if not aside[k]:
                    advance()
            for first, last in runs(aside):
                only = range(first, last + 1)
                for k, mask in zip(only, moving_masks(picture, pairs, only=only), strict=True):
                    masks[mine[k]] = lens.seen(mask) > 0
                    advance()
        else:
            for _ in mine:
                advance()
    return masks


class _Pairs(Sequence[FlowPair | None]):
    """Flow between pictures k and k + 1, measured on request; None if it cannot be trusted."""

    def __init__(self, picture: Callable[[int], np.ndarray], count: int) -> None:
        self._picture, self._count, self._dis = picture, count, Dis("medium")
        self._measured = lru_cache(maxsize=2 * REACH)(self._measure)

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, k: int) -> FlowPair | None:  # type: ignore[override]
        return self._measured(k)

    def _measure(self, k: int) -> FlowPair | None:
        first, second = (self._dis.prepare(self._picture(i)) for i in (k, k + 1))
        forward, backward = self._dis.flow(first, second), self._dis.flow(second, first)
        confidence = consistency(forward, backward)
        return FlowPair(forward, backward, confidence) if (confidence >= 128).mean() >= FOLLOWED else None


class _Lens:
    """Undistorts pictures [h, w, 3] of one camera to pinhole images, and maps masks [h, w] of these back. Without distortion both are
    returned unchanged.

    K [F, 3, 3] px of the pictures and distortion [F, 4]; all frames of a camera share one lens, so the first known one is used for all.
    """

    def __init__(self, K: np.ndarray, distortion: np.ndarray, width: int, height: int) -> None:
        self._to: tuple[np.ndarray, np.ndarray] | None = None
        known = np.flatnonzero(np.isfinite(K).all((1, 2)))
        if not len(known) or not distortion[known[0]].any():
            return
        lens, terms = K[known[0]], np.asarray(distortion[known[0]], np.float64)
        self._to = undistort_maps(lens, terms, width, height)
        x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        places = cv2.undistortPoints(np.stack([x, y], -1).reshape(-1, 1, 2), lens, terms, P=lens).reshape(height, width, 2) - 0.5
        self._back = np.ascontiguousarray(places[..., 0], np.float32), np.ascontiguousarray(places[..., 1], np.float32)

    def pinhole(self, picture: np.ndarray) -> np.ndarray:
        return picture if self._to is None else undistort(picture, self._to)

    def seen(self, mask: np.ndarray) -> np.ndarray:
        return mask if self._to is None else cv2.remap(mask, *self._back, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)


def _small(frames: FrameSet, i: int, width: int, height: int) -> np.ndarray:
    return resize(composite(frames.original(i), frames.background), width, height)
