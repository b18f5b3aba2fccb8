"""What flow a capture needs, from a glance at small pictures: none between frames that are the same, less detail where little moves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .flow_method import Dis, size_within
from .motion_mask import FLOOR, SMOOTH

if TYPE_CHECKING:
    from .frameset import FrameSet

SAMPLES = 8  # pairs that tell how much moves in a capture
GLANCE = 320  # px, longest side of the pictures that tell
LITTLE = 2.0  # px; motion below this is measured to a tenth of a pixel at half the size as well
ENOUGH = 480  # px, longest side below which nothing is saved by less
FAST = 99.0  # percentile of the lengths of a pair's flow that counts as its motion


class Glance(NamedTuple):
    """A picture without its noise: float32 [H/2, W/2, 3]."""

    smooth: np.ndarray


def glance(picture: np.ndarray) -> Glance:
    """``picture``: uint8 [H, W, 3]. Half the size and smoothed, as `MotionMask` smooths before it compares."""
    import cv2

    height, width = picture.shape[:2]
    half = cv2.resize(picture, (max(1, width // 2), max(1, height // 2)), interpolation=cv2.INTER_AREA)
    return Glance(cv2.GaussianBlur(half.astype(np.float32), (0, 0), SMOOTH, borderType=cv2.BORDER_REPLICATE))


def no_motion(first: Glance, second: Glance) -> bool:
    """Whether two pictures are the same but for noise and a shift of brightness: no pixel differs by more than the 5 grey levels from which
    `MotionMask` takes a pixel to change. With a camera that moves, this is never so."""
    difference = second.smooth - first.smooth
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
    motion = max(motion_between(frames.composited(i), frames.composited(int(frames.next[i]))) for i in chosen)
    return (max(ENOUGH, longest // 2) if motion < LITTLE else longest), motion


def motion_between(first: np.ndarray, second: np.ndarray) -> float:
    """Length in px that 99 % of the flow between two pictures uint8 [H, W, 3] stays below, measured quickly and small."""
    method = Dis("fast", GLANCE)
    flow = method.flow(method.prepare(first), method.prepare(second))
    return float(np.percentile(np.linalg.norm(flow, axis=-1), FAST))
