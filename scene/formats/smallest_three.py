"""Unit quaternions as three of their four components: the largest follows from the others, which lie within 1/sqrt(2) of 0."""

from __future__ import annotations

import numpy as np

LARGEST = 0.5**0.5  # greatest possible value of the three


def smallest_three(quats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The index [N] of the component left out of each of ``quats`` [N, 4], unit, and the other three in order [N, 3].

    q and -q are the same rotation: the sign is chosen so that the component left out is positive."""
    left_out = np.abs(quats).argmax(1)
    signs = np.where(np.take_along_axis(quats, left_out[:, None], 1) < 0, -1.0, 1.0)
    others = np.arange(3) + (np.arange(3) >= left_out[:, None])
    return left_out, np.take_along_axis(quats * signs, others, 1)
