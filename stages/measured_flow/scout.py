"""What flow a capture needs, from a glance at small pictures: none between frames that are the same, less detail where little moves."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ...vision.flow.method import Dis, size_within
from ...vision.moving.motion_mask import FLOOR, smoothed
from ..artifacts.frameset import FrameSet

SAMPLES = 8  # pairs that tell how much moves in a capture
GLANCE = 320  # px, longest side of the pictures that tell
LITTLE = 2.0  # px; below it there is little to gain from the full size, and training compares flow at half of it
ENOUGH = 480  # px, longest side below which nothing is saved by less
FAST = 99.0  # percentile of the lengths of a pair's flow that counts as its motion


def glance(picture: np.ndarray) -> np.ndarray:
    """``picture``, uint8 [H, W, 3], without its noise: float32 [H/2, W/2, 3], smoothed as `MotionMask` does before it compares."""
    height, width = picture.shape[:2]
    return smoothed(cv2.resize(picture, (max(1, width // 2), max(1, height // 2)), interpolation=cv2.INTER_AREA))


def no_motion(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether the pictures of two glances are the same but for noise and a shift of brightness.

    No pixel may differ by more than the 5 grey levels from which `MotionMask` takes a pixel to change. With a camera that moves, this is
    never so.
    """
    difference = second - first
    difference -= np.median(difference.reshape(-1, 3), axis=0)
    return float(np.abs(difference).max()) <= FLOOR


def working_size(frames: FrameSet, wanted: Sequence[int], max_size: int | None) -> tuple[int, float]:
    """Longest side in px at which flow is to be measured, and the motion in px that says so.

    Up to `SAMPLES` pairs, evenly spread, are measured quickly and small; where none moves by `LITTLE` px (a percentile of its pixels, so
    that an error at a pixel does not decide), half of the size does. ``wanted``: first frames of pairs. ``max_size``: no more than that.
    """
    longest = max(size_within(frames.width, frames.height, max_size))
    if longest <= ENOUGH:
        return longest, float("nan")
    chosen = [wanted[round(k)] for k in np.linspace(0, len(wanted) - 1, min(SAMPLES, len(wanted)))]
    motion = max(motion_between(frames.both(i)[0], frames.both(int(frames.next[i]))[0]) for i in chosen)
    return (max(ENOUGH, longest // 2) if motion < LITTLE else longest), motion


def motion_between(first: np.ndarray, second: np.ndarray) -> float:
    """Length in px that 99 % of the flow between two pictures uint8 [H, W, 3] stays below, measured quickly and small."""
    method = Dis("fast", GLANCE)
    flow = method.flow(method.prepare(first), method.prepare(second))
    return float(np.percentile(np.linalg.norm(flow, axis=-1), FAST))
