"""Triangulated points that stand alone: most of them are wrong matches, and a seed before a camera costs more than one that is missing."""

from __future__ import annotations

import numpy as np

NEIGHBOURS = 6
FACTOR = 4.0  # times the median distance to the neighbours
CLOSE = 0.05  # of the median depth of a camera's points; nearer ones are no scene


def trusted(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Which of ``points`` [P, 3] to keep, [P] bool: those with company, and not at a camera's face.

    centres [F, 3]: the cameras', world units. A point counts as alone when the mean distance to its six nearest neighbours, measured in
    distances to the nearest camera (points far away lie farther apart), is more than four times the median of that.
    """
    from scipy.spatial import cKDTree

    if len(points) <= NEIGHBOURS:
        return np.ones(len(points), bool)
    apart = cKDTree(points).query(points, k=NEIGHBOURS + 1)[0][:, 1:].mean(1)
    distance = np.maximum(cKDTree(centres).query(points)[0], 1e-12)
    relative = apart / distance
    return (relative <= FACTOR * np.median(relative)) & (distance >= CLOSE * np.median(distance))
