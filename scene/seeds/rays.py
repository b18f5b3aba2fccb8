"""Seeds along the rays of pixels, at the depth of nearby points: they fill walls and floors where no features were matched."""

from __future__ import annotations

import numpy as np

from ..views import Views

NEIGHBOURS = 6
SOFT = 4.0  # px of an image 640 px wide; added to distances, so that very near points do not dominate
OVERSAMPLED = 4  # pixels that are tried for one seed: those that have a point near, or move, get none
GAP = 0.01  # of the image width; pixels with a point this near already have a seed


def ray_seeds(
    views: Views, points: np.ndarray, frames: np.ndarray, count: int, seed: int, skip: list[np.ndarray | None] | None = None
) -> np.ndarray:
    """Up to ``count`` points [n, 3] float64 in world units, spread evenly over the images of ``frames``.

    points [P, 3]: trusted points. The inverse depth at a pixel is the mean of that of the six nearest points in the image, weighted by
    1 / (distance + 4 px)^2. Inverse depth is used because on a plane it is linear in image coordinates. Frames that show fewer than six
    points and pixels under ``skip`` (one [H, W] bool a frame, or None) get no seeds.
    """
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(seed)
    soft, gap = SOFT * views.width / 640, GAP * views.width
    found = []
    for k, i in enumerate(frames):
        shown, _, _, depth = views.project(int(i), points)
        if len(shown) < NEIGHBOURS:
            continue
        K, pose = views.K[i], views.cam_from_world[i]
        cam = points[shown] @ pose[:3, :3].T + pose[:3, 3]
        pixels = cam[:, :2] / cam[:, 2:] * K[[0, 1], [0, 1]] + K[:2, 2]
        at = spread(views.width, views.height, OVERSAMPLED * count // len(frames), rng)
        skipped = None if skip is None else skip[k]
        if skipped is not None:
            at = at[~skipped[at[:, 1].astype(int), at[:, 0].astype(int)]]
        distance, near = cKDTree(pixels).query(at, k=NEIGHBOURS)
        at, distance, near = (a[distance[:, 0] > gap] for a in (at, distance, near))
        weight = 1 / (distance + soft) ** 2
        z = weight.sum(1) / (weight / depth[near]).sum(1)
        found.append(views.lift(int(i), at, z))
    seeds = np.concatenate(found) if found else np.zeros((0, 3))
    return seeds[rng.permutation(len(seeds))[:count]]


def spread(width: int, height: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """About ``count`` pixel positions [n, 2] (x, y), one at a random place in each cell of a grid."""
    cell = (width * height / max(count, 1)) ** 0.5
    columns, rows = max(1, round(width / cell)), max(1, round(height / cell))
    y, x = np.mgrid[:rows, :columns]
    at = np.stack([x.ravel(), y.ravel()], axis=1) + rng.random((rows * columns, 2))
    return np.minimum(at * [width / columns, height / rows], [width - 1e-6, height - 1e-6])
