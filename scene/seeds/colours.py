"""The first colour of a seed: the median of what the cameras that could see it show there."""

from __future__ import annotations

import numpy as np

from ..views import Views


def median_colours(
    views: Views, points: np.ndarray, frames: np.ndarray, masks: list[np.ndarray] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Per-channel median [P, 3] in [0, 1] of what ``frames`` show at ``points`` [P, 3] (world units), and how many show each [P] int.

    Objects in front of a point in a few frames do not affect a median as they would a mean. masks: one [H, W] bool a frame; pixels where it
    is False are ignored. A point that no frame shows is grey.
    """
    looks = np.full((len(frames), len(points), 3), np.inf, np.float32)  # inf sorts after every colour
    for k, i in enumerate(frames):
        shown, x, y, _ = views.project(int(i), points)
        if masks is not None:
            on = masks[k][y, x]
            shown, x, y = shown[on], x[on], y[on]
        looks[k, shown] = views.load(int(i))[y, x] / np.float32(255)
    looks.sort(axis=0)
    count = np.isfinite(looks[..., 0]).sum(0)
    rows = np.arange(len(points))
    known = np.clip(count, 1, None)
    middle = (looks[(known - 1) // 2, rows] + looks[known // 2, rows]).astype(np.float64) / 2
    return np.where(count[:, None] > 0, middle, 0.5), count


def mean_colour(views: Views) -> tuple[float, float, float]:
    """Mean RGB in [0, 1] of the training views. As the background it keeps holes in an opaque scene from looking bright or black."""
    few = views.train[:: max(1, len(views.train) // 60)]
    means = [views.target(int(i), 0.25).double().mean((0, 1)).tolist() for i in few]
    red, green, blue = (sum(channel) / len(few) for channel in zip(*means))
    return red, green, blue
