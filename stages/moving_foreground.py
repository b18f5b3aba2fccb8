"""What stands out from a fixed camera's background in each frame: the per-frame companion of `MotionMask`, with the same noise model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .motion_mask import SHIFT_STEP, MotionMask, smoothed
from .moving_evidence import DECADE, Evidence
from .moving_objects import moving_mask


class FrameForeground(MotionMask):
    """Per-frame masks of one fixed camera: `foreground(frame)` at any time after construction.

    The background is the temporal median of the sampled frames, so what stands still for more than half of them is background, and
    where it leaves, what it hid is foreground for once. `add` and `mask` work as in `MotionMask`.
    """

    def evidence(self, frame: np.ndarray) -> Evidence:
        """Difference of one frame, uint8 [H, W, 3], to the background, in thresholds of `MotionMask`; every pixel counts alike."""
        if frame.shape != self._background.shape or frame.dtype != np.uint8:
            raise ValueError(f"frame: expected uint8 {list(self._background.shape)}, got {frame.dtype} {list(frame.shape)}")
        difference = smoothed(frame) - self._background
        difference -= np.median(difference[::SHIFT_STEP, ::SHIFT_STEP], axis=(0, 1))  # exposure and white balance of the frame
        ratio = (np.abs(difference) * self._inverse_threshold).max(-1)
        score = np.clip(np.log(np.maximum(ratio, 1e-6)) / np.log(DECADE), -1.0, 1.0).astype(np.float32)
        return Evidence(score, np.ones_like(score), 0.0)

    def foreground(self, frame: np.ndarray) -> np.ndarray:
        """Mask uint8 [H, W] of one frame: 255 where it differs from the background, along the edges of the picture."""
        return moving_mask(frame, self.evidence(frame))


def frame_foregrounds(frames: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Masks uint8 [H, W] of all frames, uint8 [H, W, 3], of one fixed camera."""
    from .motion_mask import sample

    background = FrameForeground([frames[i] for i in sample(range(len(frames)))])
    return [background.foreground(frame) for frame in frames]
