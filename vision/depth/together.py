"""Depth of a camera that stands still, whose points nobody knows: its maps are scaled to agree with one another where nothing moves."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np

LEAST_STEP, NOISE = 0.1, 3.0  # least change over time, and times the usual one, of the logarithm where something moves
NOISY = 30  # of so many values at a pixel, one at either end is taken for noise
SHARE, CLEAR = 0.001, 1.3  # least share of the pixels that change, and how many times as many steps must one extreme have
FARTHEST = 10.0  # times the usual depth: the values of farther pixels say nothing about how far they are


def depth_of_inverse(values: np.ndarray) -> np.ndarray:
    """Depth [h, w], up to scale, of inverse depth ``values`` [h, w] of a network, 0 where they are unknown. Networks give about 0 for what
    is infinitely far, so without known points no shift is assumed."""
    there = values > 0
    if not there.any():
        return np.zeros_like(values, np.float32)
    least = float(np.median(values[there])) / FARTHEST
    return np.where(there, 1 / np.maximum(values, least), 0).astype(np.float32)


def scale_together(
    depths: Mapping[int, np.ndarray], rest: Mapping[int, np.ndarray | None], distance: float
) -> tuple[dict[int, np.ndarray], dict[int, float]]:
    """For each frame of ``depths`` [h, w], all of one size and 0 where unknown, the scale [1] that divides it to world units, in which the
    median of what all show is ``distance``; and how far it is from the others then, as a median share. rest: [h, w] bool, what is known to
    be at rest; None: everything. Others that move are outvoted: the median over time leaves them out. At least one depth must be known."""
    logs = {}
    for i, depth in depths.items():
        known = depth > 0
        mask = rest.get(i)
        used = known if mask is None or not (known & mask).any() else known & mask
        logs[i] = np.where(used, np.log(np.maximum(depth, 1e-9)), np.nan)
    logs = {i: one for i, one in logs.items() if np.isfinite(one).any()}
    together = _median_over_time(logs)
    together += np.log(distance) - np.nanmedian(together)
    scales, errors = {}, {}
    for i, one in logs.items():
        off = together - one
        factor = float(np.nanmedian(off))
        scales[i], errors[i] = np.exp([-factor]), float(np.nanmedian(np.abs(off - factor)))
    return scales, errors


def is_inverse(values: Mapping[int, np.ndarray]) -> bool | None:
    """Whether the maps ``values`` [h, w] by frame, all of one size and 0 where unknown, grow towards the camera. None if nothing tells.

    What moves is before the background. So where values change, the background alone, which is one of their extremes over time, has fewer
    steps than the other one, in which what moves leaves a trail."""
    logs = {i: np.where(one > 0, np.log(np.maximum(one, 1e-9)), np.nan) for i, one in values.items() if (one > 0).any()}
    if not logs:
        return None
    together = _median_over_time(logs)
    off = np.stack([one - together - np.nanmedian(one - together) for one in logs.values()])
    known = np.isfinite(off).all(axis=0)
    if not known.any():
        return None
    end = len(off) // NOISY
    least, most = np.sort(off, axis=0)[[end, -1 - end]]
    change = np.where(known, most - least, 0)
    changes = change > max(LEAST_STEP, NOISE * float(np.median(change[known])))
    if changes.mean() < SHARE:
        return None
    around = cv2.dilate(changes.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    low, high = (_steps(together + one, around) for one in (least, most))
    if max(low, high) < CLEAR * min(low, high):
        return None
    return high > low


def _steps(values: np.ndarray, where: np.ndarray) -> float:
    """Sum of the differences of neighbours in ``values`` [h, w] at the pixels ``where`` [h, w]."""
    across, down = np.abs(np.diff(values, axis=1))[:-1], np.abs(np.diff(values, axis=0))[:, :-1]
    return float(np.nansum(np.where(where[:-1, :-1], across + down, 0)))


def _median_over_time(logs: Mapping[int, np.ndarray]) -> np.ndarray:
    """[h, w] of maps [h, w], each without its own median; NaN where none is known."""
    stack = np.stack([one - np.nanmedian(one) for one in logs.values()])
    somewhere = np.isfinite(stack).any(axis=0)
    together = np.full(somewhere.shape, np.nan)
    together[somewhere] = np.nanmedian(stack[:, somewhere], axis=0)
    return together
