"""Finishes the result of structure from motion: drops bad points and sets the scale."""

from __future__ import annotations

import numpy as np

from .alignment import camera_centres

MEDIAN_DISTANCE = 4.0  # world units from the cameras to the scene, after normalisation
POINT_ERROR = 2.0  # px; points with a larger error are outliers
FAR = 30.0  # times the median distance of points from their median; farther points were triangulated with almost no angle


def keep_points(points: np.ndarray, errors: np.ndarray, tracks: np.ndarray) -> np.ndarray:
    """[P] bool: points with a small error, not absurdly far, and seen in three views if there are at least 100 of those."""
    keep = np.isfinite(points).all(axis=1) & (errors <= POINT_ERROR)
    if (keep & (tracks >= 3)).sum() >= 100:
        keep &= tracks >= 3
    if keep.any():
        distance = np.linalg.norm(points - np.median(points[keep], axis=0), axis=1)
        keep &= distance <= FAR * np.median(distance[keep])
    return keep


def normalise(cam_from_world: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scales poses [N,4,4] and points [P,3] so that the median distance from the cameras to the median point is 4."""
    distance = float(np.median(np.linalg.norm(camera_centres(cam_from_world) - np.median(points, axis=0), axis=1)))
    scale = MEDIAN_DISTANCE / distance
    poses = cam_from_world.copy()
    poses[:, :3, 3] *= scale
    return poses, points * scale
