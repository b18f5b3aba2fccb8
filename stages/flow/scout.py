"""Decides from small pictures what flow a capture needs: none between identical frames, a lower resolution where little moves."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ...pipeline.choice.evenly import evenly
from ...vision.flow.method import Dis
from ...vision.images.pictures import size_within
from ...vision.moving.motion_mask import FLOOR, smoothed
from ..shared.frameset import FrameSet

SAMPLES = 8  # pairs from which the motion of a capture is estimated
GLANCE = 320  # px, longest side of the pictures for this estimate
LITTLE = 2.0  # px of motion; below it the full size gains little, and training compares flow at half size anyway
ENOUGH = 480  # px, longest side; flow of pictures up to this size is always measured at full size
FAST = 99.0  # percentile of the flow lengths of a pair that counts as its motion


def glance(picture: np.ndarray) -> np.ndarray:
    """``picture``, uint8 [H, W, 3], denoised: float32 [H/2, W/2, 3], smoothed as in `MotionMask` before its comparison."""
    height, width = picture.shape[:2]
    return smoothed(cv2.resize(picture, (max(1, width // 2), max(1, height // 2)), interpolation=cv2.INTER_AREA))


def no_motion(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether two pictures, given as their glances, are the same except for noise and a shift of brightness.

    No pixel may differ by more than 5 grey levels, the threshold of `MotionMask` for a changed pixel. If the camera moves, this is never
    the case.
    """
    difference = second - first
    difference -= np.median(difference.reshape(-1, 3), axis=0)
    return float(np.abs(difference).max()) <= FLOOR


def working_size(frames: FrameSet, wanted: Sequence[int], max_size: int | None) -> tuple[int, float]:
    """Longest side in px at which flow is to be measured, and the motion in px on which this is based.

    The flow of up to `SAMPLES` evenly spread pairs is measured quickly at a small size. If no pair moves by `LITTLE` px, half the size is
    enough. The motion of a pair is a percentile over its pixels, so that an error at one pixel does not decide. ``wanted``: first frames
    of the pairs. ``max_size``: upper limit of the result.
    """
    longest = max(size_within(frames.width, frames.height, max_size))
    if longest <= ENOUGH:
        return longest, float("nan")
    chosen = evenly(wanted, SAMPLES)
    motion = max(motion_between(frames.both(i)[0], frames.both(int(frames.next[i]))[0]) for i in chosen)
    return (max(ENOUGH, longest // 2) if motion < LITTLE else longest), motion


def motion_between(first: np.ndarray, second: np.ndarray) -> float:
    """99th percentile of the flow length in px between two pictures uint8 [H, W, 3], measured quickly at a small size."""
    method = Dis("fast", GLANCE)
    flow = method.flow(method.prepare(first), method.prepare(second))
    return float(np.percentile(np.linalg.norm(flow, axis=-1), FAST))
