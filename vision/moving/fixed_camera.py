"""A mask per frame of what moves in front of a fixed camera: pixels that differ from the background, and the rest of the same objects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...pipeline.choice.evenly import evenly
from .colours import colour_odds, odds_at
from .evidence import DECADE, Evidence
from .motion_mask import SAMPLES, SHIFT_STEP, MotionMask, smoothed
from .moving_masks import moving_mask

SIZE = 640  # px, about, of the longest side at which evidence is gathered; larger pictures are averaged down, which also reduces noise
NOISIER = 1.5  # times the picture's noise, the most assumed at any brightness: shot noise grows with the root of brightness, but a moving
# object may fill a band of brightness by itself, and its motion is not noise
CHANGES = 2.0  # log odds of a full change; the background may hold what stood there first, so colour can outvote it
STATIC = -1.0  # log odds of no change; what does not move for a long time is background, unless its colour moves elsewhere
ONCE = 0.1  # share of a masked region that must change at some time; a region that never does only shares the colour of something moving


class FixedCameraMasks:
    """Per-frame masks of one fixed camera: call `moving(frame)` at any time after construction.

    The background is the temporal median of the sampled frames. A person who stays in one place most of the time is part of it, so the
    difference alone finds arms and outlines, not torsos. Colours find the rest: those that change more often than others are taken as
    colours of moving objects (`colour_odds`). Both kinds of evidence are added and averaged within the edges of the picture
    (`moving_mask`), and a region is kept if part of it changes at some time. Noise alone masks nothing.
    """

    def __init__(self, sampled: Sequence[np.ndarray]) -> None:
        """``sampled``: at least one frame, uint8 [H, W, 3], spread over the capture. Raises ValueError if there is none."""
        if not sampled:
            raise ValueError("sampled: expected at least one frame")
        self._shape = sampled[0].shape
        small = [self._reduced(frame) for frame in sampled]
        self._change = _Change(small)
        changed = [self._change.score(frame) > 0 for frame in small]
        self._ever = np.any(changed, axis=0)
        self._odds = colour_odds(small, changed)

    def evidence(self, frame: np.ndarray) -> Evidence:
        """Evidence of one frame, uint8 [H, W, 3]: log odds of motion, float32 in [-3, 4]; all pixels have equal weight."""
        return self._evidence(frame)[0]

    def moving(self, frame: np.ndarray) -> np.ndarray:
        """Mask uint8 [H, W] of one frame, aligned with its edges: 255 on objects that move now or at another time."""
        import cv2

        found, changed = self._evidence(frame)
        mask = moving_mask(frame, found)
        ever = cv2.resize((self._ever | changed).astype(np.uint8), mask.shape[::-1], interpolation=cv2.INTER_NEAREST)
        count, labels = cv2.connectedComponents(mask, connectivity=8)
        area = np.bincount(labels.ravel(), minlength=count)
        keep = np.bincount(labels[ever > 0], minlength=count) >= ONCE * area
        return np.where(keep[labels], mask, 0).astype(np.uint8)

    def _evidence(self, frame: np.ndarray) -> tuple[Evidence, np.ndarray]:
        """The evidence, and where the reduced frame changes, bool."""
        import cv2

        if frame.shape != self._shape or frame.dtype != np.uint8:
            raise ValueError(f"frame: expected uint8 {list(self._shape)}, got {frame.dtype} {list(frame.shape)}")
        small = self._reduced(frame)
        change = self._change.score(small)
        score = np.where(change > 0, CHANGES * change, STATIC) + odds_at(self._odds, small)
        score = cv2.resize(score.astype(np.float32), frame.shape[1::-1], interpolation=cv2.INTER_LINEAR)
        return Evidence(score, np.ones_like(score), 0.0), change > 0

    def _reduced(self, frame: np.ndarray) -> np.ndarray:
        import cv2

        factor = max(1, round(max(frame.shape[:2]) / SIZE))
        size = max(1, frame.shape[1] // factor), max(1, frame.shape[0] // factor)
        return cv2.resize(frame, size, interpolation=cv2.INTER_AREA) if factor > 1 else frame


class _Change(MotionMask):
    """The noise model of `MotionMask`, with thresholds limited by `NOISIER`."""

    def __init__(self, sampled: Sequence[np.ndarray]) -> None:
        super().__init__(sampled)
        usual = np.median(self._inverse_threshold, axis=(0, 1))
        self._inverse_threshold = np.maximum(self._inverse_threshold, usual / NOISIER)

    def score(self, frame: np.ndarray) -> np.ndarray:
        """Log difference from the background, float32 [H, W] in [-1, 1]: 0 at the threshold, 1 at `DECADE` times it, -1 at 1/`DECADE`."""
        import cv2

        difference = smoothed(frame) - self._background
        difference -= np.median(difference[::SHIFT_STEP, ::SHIFT_STEP], axis=(0, 1))  # exposure and white balance of the frame
        red, green, blue = cv2.split(np.abs(difference) * self._inverse_threshold)
        ratio = np.maximum(np.maximum(red, green), blue)
        return np.clip(np.log(np.maximum(ratio, 1e-6)) / np.log(DECADE), -1.0, 1.0).astype(np.float32)


def fixed_camera_masks(frames: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Masks uint8 [H, W] of all frames, uint8 [H, W, 3], of one fixed camera."""
    background = FixedCameraMasks(evenly(frames, SAMPLES))
    return [background.moving(frame) for frame in frames]
