"""One picture a camera of what stands still: before fixed cameras the median over time, in which what passes by does not show."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...scene.training.curriculum import MIN_CAMERAS
from ...scene.views import Views

FRAMES = 32  # of moving cameras
LOOKS = 9  # times that the median is taken over


class Plates(NamedTuple):
    """Of C places of cameras: frames [C] int, one of each; pictures, uint8 [H, W, 3] each; still, [H, W] bool each: where nothing moved."""

    frames: np.ndarray
    pictures: list[np.ndarray]
    still: list[np.ndarray]


def clean_plates(views: Views, mask: Callable[[int], np.ndarray | None], fixed: bool) -> Plates:
    """Of the training cameras at the middle time, where they are ``fixed`` over all times; where few see one time, of frames from all of
    the cameras' way.

    mask(i): [H, W] bool, what moves in frame i, or None where that is not known.
    """
    times = np.unique(views.time[views.train])
    frames = views.train[views.time[views.train] == times[len(times) // 2]]
    if len(frames) < MIN_CAMERAS:
        frames = views.train[np.unique(np.linspace(0, len(views.train) - 1, min(FRAMES, len(views.train))).round().astype(int))]
    pictures, still = [], []
    for i in frames:
        looks = views.train[views.camera[views.train] == views.camera[i]] if fixed else np.array([i])
        looks = looks[np.unique(np.linspace(0, len(looks) - 1, min(LOOKS, len(looks))).round().astype(int))]
        pictures.append(np.median(np.stack([views.load(int(j)) for j in looks]), axis=0).astype(np.uint8))
        masks = [m for j in looks if (m := mask(int(j))) is not None]
        moves = np.mean(masks, axis=0) >= 0.5 if masks else np.zeros((views.height, views.width), bool)
        still.append(~moves)
    return Plates(frames, pictures, still)
