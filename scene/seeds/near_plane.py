"""The near plane: primitives nearer to a camera than anything real would hide the scene from views that were not trained on."""

from __future__ import annotations

import numpy as np

from ..views import Views

OF_VIEWING_DISTANCE = 0.2  # at most this share of the viewing distance
OF_NEAREST = 0.5  # of the depth of the nearest trusted points
NEAREST_SHARE = 0.01  # of a view's points may be nearer: they are wrong matches
LEAST_POINTS = 20  # views that show fewer are ignored
WITHOUT = 0.05  # of the viewing distance, if no view shows enough points


def near_plane(views: Views, points: np.ndarray) -> float:
    """The near plane for all cameras, world units: half the depth of the nearest of the trusted ``points`` [P, 3] in any training view, and
    at most a fifth of the viewing distance, since held-out cameras may come nearer."""
    unit = views.viewing_distance(points)
    nearest = []
    for i in views.train[:: max(1, len(views.train) // 120)]:
        depth = views.project(int(i), points).depth
        if len(depth) >= LEAST_POINTS:
            nearest.append(float(np.quantile(depth, NEAREST_SHARE)))
    if not nearest:
        return WITHOUT * unit
    return min(OF_VIEWING_DISTANCE * unit, OF_NEAREST * min(nearest))
