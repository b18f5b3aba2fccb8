"""Points spread evenly over a sphere: where the corners of a new convex start."""

from __future__ import annotations

import math

import numpy as np


def fibonacci_sphere(count: int) -> np.ndarray:
    """``count`` points [count, 3] float64 on the unit sphere, evenly spread along a golden-angle spiral; their mean is near the centre."""
    if count < 1:
        raise ValueError(f"count must be at least 1, got {count}")
    index = np.arange(count) + 0.5
    polar = np.arccos(1 - 2 * index / count)
    azimuth = math.pi * (3 - math.sqrt(5)) * index
    return np.stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=1)


def neighbour_radius(centres: np.ndarray) -> np.ndarray:
    """Mean distance [N] of each of ``centres`` [N, 3] to its three nearest neighbours: small in dense regions, large in sparse ones.

    With fewer than two centres there is no neighbour, and the radius is 1. Coincident centres get the smallest positive radius of the set.
    """
    from scipy.spatial import cKDTree

    n = len(centres)
    if n < 2:
        return np.ones(n)
    distance = cKDTree(centres).query(centres, k=min(4, n))[0][:, 1:].mean(axis=1)
    positive = distance[distance > 0]
    return np.maximum(distance, positive.min() if len(positive) else 1.0)
