"""Depth of a camera that stands still, whose points nobody knows: its maps are scaled to agree with one another where nothing moves."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

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
    stack = np.stack([one - np.nanmedian(one) for one in logs.values()])
    somewhere = np.isfinite(stack).any(axis=0)
    together = np.full(somewhere.shape, np.nan)
    together[somewhere] = np.nanmedian(stack[:, somewhere], axis=0)
    together += np.log(distance) - np.nanmedian(together)
    scales, errors = {}, {}
    for i, one in logs.items():
        off = together - one
        factor = float(np.nanmedian(off))
        scales[i], errors[i] = np.exp([-factor]), float(np.nanmedian(np.abs(off - factor)))
    return scales, errors
