"""Isolated triangulated points: most are wrong matches, and a wrong seed in front of a camera costs more than a missing one."""

from __future__ import annotations

import numpy as np

NEIGHBOURS = 6
FACTOR = 4.0  # times the median distance to the neighbours
CLOSE = 0.05  # of the median distance of points to their nearest camera; nearer ones are not part of the scene


def trusted(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Which of ``points`` [P, 3] to keep, [P] bool: those that are not isolated and not right in front of a camera.

    centres [F, 3]: camera centres, world units. A point is isolated if the mean distance to its six nearest neighbours, divided by the
    distance to its nearest camera (far points lie farther apart), is more than four times the median of this ratio.
    """
    from scipy.spatial import cKDTree

    if len(points) <= NEIGHBOURS:
        return np.ones(len(points), bool)
    apart = cKDTree(points).query(points, k=NEIGHBOURS + 1)[0][:, 1:].mean(1)
    distance = np.maximum(cKDTree(centres).query(points)[0], 1e-12)
    relative = apart / distance
    return (relative <= FACTOR * np.median(relative)) & (distance >= CLOSE * np.median(distance))
