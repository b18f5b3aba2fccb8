"""The volume that the cameras look at together."""

from __future__ import annotations

import numpy as np

from ..views import Views


def common_volume(views: Views) -> tuple[np.ndarray, float]:
    """Centre [3] and radius (world units) of the ball that the training cameras look at.

    The centre is the point nearest to all optical axes (least squares). The radius is that of the largest ball around it that the median
    camera sees completely. Cameras with parallel axes have no such point; the centre then lies in front of them, at a distance equal to
    the extent over which they are spread.
    """
    train = views.train
    R = views.cam_from_world[train, :3, :3]
    axis, centre = R[:, 2], views.centres()[train]
    projector = np.eye(3)[None] - axis[:, :, None] * axis[:, None, :]
    A = projector.sum(0)
    spread = max(float(np.linalg.norm(centre - centre.mean(0), axis=1).max()), 1e-3)
    if np.linalg.cond(A) < 1e4:
        target = np.linalg.solve(A, (projector @ centre[:, :, None]).sum(0)[:, 0])
    else:
        target = centre.mean(0) + axis.mean(0) * spread
    depth = np.einsum("fk,fk->f", axis, target - centre)
    if np.median(depth) <= 0:  # the axes diverge: the common volume is around the cameras
        return centre.mean(0), 2 * spread
    half = np.minimum(views.width / (2 * views.K[train, 0, 0]), views.height / (2 * views.K[train, 1, 1]))
    return target, float(np.median(depth * np.sin(np.arctan(half))))
