"""Seeds on a shell around everything: cameras that surround a scene also see what lies behind the cameras opposite."""

from __future__ import annotations

import numpy as np

from ..views import Views

SURROUNDED = 0.5  # length of the mean viewing direction; below this the cameras face one another


def surrounded(views: Views) -> bool:
    """Whether the training cameras stand around what they look at."""
    return bool(np.linalg.norm(views.cam_from_world[views.train, 2, :3].mean(0)) < SURROUNDED)


def shell_seeds(views: Views, points: np.ndarray, count: int, seed: int) -> np.ndarray:
    """``count`` points [count, 3], spread uniformly by area over the convex hull of ``points`` [P, 3] and the training cameras' centres
    (world units). No points if these all lie in one plane."""
    from scipy.spatial import ConvexHull, QhullError

    corners = np.concatenate([points, views.centres()[views.train]])
    try:
        triangles = corners[ConvexHull(corners).simplices]
    except (QhullError, ValueError):
        return np.zeros((0, 3))
    rng = np.random.default_rng(seed)
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    chosen = rng.choice(len(triangles), count, p=area / area.sum())
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)  # the other half of the parallelogram, folded back
    return a[chosen] + u * (b - a)[chosen] + v * (c - a)[chosen]
