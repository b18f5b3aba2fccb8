"""From how many sides the training views show a point."""

from __future__ import annotations

import numpy as np

from ...pipeline.choice.evenly import evenly
from ..views import Views

POINTS, LOOKS = 500, 60  # of each, at most; evenly spread


def path_width(views: Views, points: np.ndarray) -> float:
    """Median over the ``points`` [P, 3] (world units) of the angle in degrees between the two outermost directions from which training
    frames see a point; 0 if none sees any."""
    points = evenly(points, POINTS)
    chosen = evenly(views.train, LOOKS)
    ray = points[:, None] - views.centres()[chosen]  # [P, F, 3]
    ray = ray / np.maximum(np.linalg.norm(ray, axis=2, keepdims=True), 1e-12)
    seen = np.zeros(ray.shape[:2], bool)
    for k, i in enumerate(chosen):
        seen[views.project(int(i), points).point, k] = True
    cosine = np.where(seen[:, :, None] & seen[:, None], ray @ ray.transpose(0, 2, 1), 1.0)
    widest = np.degrees(np.arccos(np.clip(cosine.min((1, 2)), -1, 1)))[seen.any(1)]
    return float(np.median(widest)) if len(widest) else 0.0
