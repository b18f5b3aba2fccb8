"""Which pixels of a fixed camera ever change. This decides what training may treat as static."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

import numpy as np

from ...pipeline.choice.evenly import evenly

SAMPLES = 25  # frames for the background and its noise; all frames are then compared with it
SMOOTH = 1.2  # px, averages out sensor noise before the comparison; the noise is measured after smoothing
FLOOR = 5.0  # grey levels; compression shifts flat areas by less, and 8 bits hold nothing finer
NOISE_FACTOR = 5.0  # standard deviations of the noise that a change must exceed
SHIFT_STEP = 3  # px; a ninth of the pixels is enough to measure the brightness shift of the whole frame
SPECK = 12  # px; smaller connected changes are noise that passed the threshold


class MotionMask:
    """Accumulates the frames of one fixed camera and finds the pixels that change: `add` every frame once, then call `mask`.

    The background is the temporal median of up to `SAMPLES` frames. Frames are smoothed, and each frame's own brightness shift is removed.
    A pixel changes if some frame then differs from the background, in any channel, by more than 5 grey levels and by more than 5 standard
    deviations of the camera's noise at that brightness. Slow shadows count as change; flicker of the whole picture does not.
    """

    def __init__(self, sampled: Sequence[np.ndarray]) -> None:
        """``sampled``: at least one frame, uint8 [H, W, 3], spread over the capture."""
        if not sampled:
            raise ValueError("sampled: expected at least one frame")
        frames = np.stack([smoothed(frame) for frame in sampled])
        self._background = np.median(frames, axis=0).astype(np.float32)
        self._largest = np.zeros(self._background.shape[:2], np.float32)
        self._inverse_threshold = 1.0 / _threshold(frames, self._background)
        self._lock = threading.Lock()

    def add(self, frame: np.ndarray) -> None:
        """Adds one frame of the camera, uint8 [H, W, 3]. The result does not depend on the order, and any thread may call this."""
        import cv2

        difference = smoothed(frame) - self._background
        difference -= np.median(difference[::SHIFT_STEP, ::SHIFT_STEP], axis=(0, 1))  # exposure and white balance of the frame
        np.abs(difference, out=difference)
        difference *= self._inverse_threshold
        red, green, blue = cv2.split(difference)
        largest = np.maximum(np.maximum(red, green), blue)
        with self._lock:
            np.maximum(self._largest, largest, out=self._largest)

    def mask(self, grow: int) -> np.ndarray:
        """uint8 [H, W]: 255 where the pixel, or one within ``grow`` px, changes; 0 elsewhere."""
        import cv2

        changed = (self._largest > 1.0).astype(np.uint8)
        count, labels, stats, _ = cv2.connectedComponentsWithStats(changed, connectivity=8)
        keep = np.zeros(count, bool)
        keep[1:] = stats[1:, cv2.CC_STAT_AREA] >= SPECK
        changed = keep[labels]
        if not changed.any():
            return np.zeros(changed.shape, np.uint8)
        distance = cv2.distanceTransform((~changed).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        return np.where(distance <= grow + 1e-3, 255, 0).astype(np.uint8)


def smoothed(frame: np.ndarray) -> np.ndarray:
    """``frame`` [H, W, 3] as float32 with its sensor noise averaged out."""
    import cv2

    return cv2.GaussianBlur(frame.astype(np.float32), (0, 0), SMOOTH, borderType=cv2.BORDER_REPLICATE)


def _threshold(frames: np.ndarray, background: np.ndarray) -> np.ndarray:
    """[H, W, 3] grey levels that a change must exceed. The noise is measured per channel, in 16 bands of brightness.

    The median over time of |frame - background| measures the noise if the pixel is static for half of the time, and the median over a
    band's pixels does if half of them are static. A factor of 1.4826 turns it into a standard deviation.
    """
    deviation = np.median(np.abs(frames - background), axis=0)
    band = np.clip(background / 16.0, 0, 15).astype(int)
    threshold = np.empty_like(background)
    for channel in range(3):
        everywhere = float(np.median(deviation[..., channel]))
        noise = np.full(16, everywhere)
        for b in range(16):
            inside = deviation[..., channel][band[..., channel] == b]
            if inside.size >= 256:
                noise[b] = np.median(inside)
        threshold[..., channel] = np.maximum(FLOOR, NOISE_FACTOR * 1.4826 * noise)[band[..., channel]]
    return threshold


def motion_mask(load: Callable[[int], np.ndarray], frames: Sequence[int], grow: int = 4) -> np.ndarray:
    """Mask of the pixels that change in ``frames`` of one fixed camera, uint8 [H, W]; ``load(i)`` gives uint8 [H, W, 3]. See `MotionMask`.

    At most `SAMPLES` frames are in memory at once.
    """
    collector = MotionMask([load(i) for i in evenly(frames, SAMPLES)])
    for i in frames:
        collector.add(load(i))
    return collector.mask(grow)
