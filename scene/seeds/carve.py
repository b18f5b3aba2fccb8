"""Seeds inside silhouettes: the common volume of the cameras, carved where they saw background."""

from __future__ import annotations

import numpy as np

from ..views import Views
from .volume import common_volume

MAJORITY = 0.8


def carve(views: Views, objects: list[np.ndarray], frames: np.ndarray, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """``count`` points [count, 3] in the common volume that most views saw as an object, with their mean colours [count, 3] in [0, 1].

    objects: a mask [H, W] bool for each frame of ``frames``. Objects move between frames, so a majority of views decides, not all of them:
    points are drawn from the candidates that at least the share `MAJORITY` of the views see as an object. If these are fewer than
    ``count``, the candidates with the next largest shares are added.
    """
    centre, radius = common_volume(views)
    rng = np.random.default_rng(seed)
    candidates = centre + rng.uniform(-radius, radius, (max(12 * count, 50_000), 3))
    hits, seen = np.zeros(len(candidates)), np.zeros(len(candidates))
    for mask, i in zip(objects, frames):
        shown, x, y, _ = views.project(int(i), candidates)
        seen[shown] += 1
        hits[shown] += mask[y, x]
    share = np.where(seen >= 0.5 * len(frames), hits / np.maximum(seen, 1), 0.0)
    order = np.argsort(-share, kind="stable")
    solid = int((share >= MAJORITY).sum())
    chosen = rng.permutation(order[: max(solid, count)])[:count]
    points = candidates[chosen]

    color, weight = np.zeros((count, 3)), np.zeros(count)
    for mask, i in zip(objects, frames):
        shown, x, y, _ = views.project(int(i), points)
        on = mask[y, x]
        image = views.target(int(i)).cpu().numpy()
        color[shown[on]] += image[y[on], x[on]]
        weight[shown[on]] += 1
    return points, np.where(weight[:, None] > 0, color / np.maximum(weight, 1)[:, None], 0.5)
