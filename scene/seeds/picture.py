"""A picture of the seeds, drawn over a training picture."""

from __future__ import annotations

import cv2
import numpy as np

from ..views import Views
from .moving.moving_seeds import MovingSeeds

SIZE = 720  # px, longest side
DIMMED = 0.35  # brightness of the grey picture under the seeds, relative to the original
MOVING = (255, 120, 0)


def seeds_picture(views: Views, points: np.ndarray, colors: np.ndarray, moving: MovingSeeds | None) -> np.ndarray:
    """uint8 [h, w, 3]: ``points`` [P, 3] (world units) as dots in their ``colors`` [P, 3] in [0, 1] over the middle training picture in
    grey. On top, with an orange rim, the seeds on moving objects of the time nearest to the picture's."""
    i = int(views.train[len(views.train) // 2])
    grey = cv2.cvtColor(views.load(i), cv2.COLOR_RGB2GRAY)
    factor = min(1.0, SIZE / max(views.width, views.height))
    size = max(1, round(views.width * factor)), max(1, round(views.height * factor))
    picture = np.repeat((DIMMED * cv2.resize(grey, size, interpolation=cv2.INTER_AREA)).astype(np.uint8)[..., None], 3, axis=2)
    layers: list[tuple[np.ndarray, np.ndarray, int, tuple[int, int, int] | None]] = [(points, colors, 1, None)]
    if moving is not None:
        now = moving.time == moving.time[np.abs(moving.time - views.time[i]).argmin()]
        layers.append((moving.points[now], moving.colors[now], 2, MOVING))
    for places, rgb, radius, rim in layers:
        at = views.project(i, np.asarray(places, np.float64))
        shown = (255 * np.clip(np.asarray(rgb)[at.point], 0, 1)).round().astype(int)
        for k in np.argsort(-at.depth, kind="stable"):  # near dots cover far ones
            centre = int(at.x[k] * factor), int(at.y[k] * factor)
            if rim is not None:
                cv2.circle(picture, centre, radius, rim, -1)
            cv2.circle(picture, centre, radius - 1 if rim is not None else radius, shown[k].tolist(), -1)
    return picture
