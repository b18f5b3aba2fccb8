"""Seeds without points: inside the volume that the cameras share, carved by what they saw as background."""

from __future__ import annotations

import numpy as np

from .views import Views


def common_volume(views: Views) -> tuple[np.ndarray, float]:
    """Centre [3] and radius (world units) of the ball that the training cameras look at.

    The centre is the point nearest to all optical axes (least squares); the radius is that of the largest ball around it that the
    median camera sees whole. Cameras with parallel axes have no such point: then the centre lies ahead of them, at the distance over
    which they are spread.
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
    if np.median(depth) <= 0:  # axes diverge: what they share lies around the cameras
        return centre.mean(0), 2 * spread
    half = np.minimum(views.width / (2 * views.K[train, 0, 0]), views.height / (2 * views.K[train, 1, 1]))
    return target, float(np.median(depth * np.sin(np.arctan(half))))


def carve(
    views: Views, foreground: list[np.ndarray], frames: np.ndarray, count: int, seed: int, majority: float = 0.8
) -> tuple[np.ndarray, np.ndarray]:
    """``count`` points [count, 3] in the common volume that most views saw as foreground, with their mean colours [count, 3] in [0, 1].

    foreground: one [H, W] bool a frame of ``frames``. Objects move between frames, so a majority decides, not every view: candidates
    are taken by the share of views in which they lie on the foreground, from ``majority`` downwards until there are enough.
    """
    centre, radius = common_volume(views)
    rng = np.random.default_rng(seed)
    candidates = centre + rng.uniform(-radius, radius, (max(12 * count, 50_000), 3))
    hits, seen = np.zeros(len(candidates)), np.zeros(len(candidates))
    for mask, i in zip(foreground, frames):
        shown, x, y, _ = views.project(int(i), candidates)
        seen[shown] += 1
        hits[shown] += mask[y, x]
    share = np.where(seen >= 0.5 * len(frames), hits / np.maximum(seen, 1), 0.0)
    order = np.argsort(-share, kind="stable")
    solid = int((share >= majority).sum())
    chosen = rng.permutation(order[: max(solid, count)])[:count]
    points = candidates[chosen]

    color, weight = np.zeros((count, 3)), np.zeros(count)
    for mask, i in zip(foreground, frames):
        shown, x, y, _ = views.project(int(i), points)
        on = mask[y, x]
        image = views.target(int(i)).cpu().numpy()
        color[shown[on]] += image[y[on], x[on]]
        weight[shown[on]] += 1
    return points, np.where(weight[:, None] > 0, color / np.maximum(weight, 1)[:, None], 0.5)
