"""One picture of the static scene per camera. For fixed cameras it is the median over time, from which passing objects vanish."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...pipeline.choice.evenly import evenly
from ..training.curriculum import MIN_CAMERAS
from ..views import Views

FRAMES = 32  # number of frames used from moving cameras
MOST = 100  # frames of one time; a video of a static scene may have more, whose pictures would not fit into memory
LOOKS = 9  # number of times over which the median is taken


class Plates(NamedTuple):
    """For C camera positions: frames [C] int, one frame each; pictures, uint8 [H, W, 3] each; static, [H, W] bool each: static pixels."""

    frames: np.ndarray
    pictures: list[np.ndarray]
    static: list[np.ndarray]


def clean_plates(views: Views, mask: Callable[[int], np.ndarray | None], fixed: bool) -> Plates:
    """Plates of the training cameras at the middle time; if the cameras are ``fixed``, medians over all times. If few cameras that move see
    one time, frames evenly spread over the training frames are used instead.

    mask(i): [H, W] bool, moving pixels of frame i, or None if unknown.
    """
    times = np.unique(views.time[views.train])
    frames = views.train[views.time[views.train] == times[len(times) // 2]]
    if len(frames) < MIN_CAMERAS and not fixed:
        frames = evenly(views.train, FRAMES)
    frames = evenly(frames, MOST)
    pictures, static = [], []
    for i in frames:
        looks = views.train[views.camera[views.train] == views.camera[i]] if fixed else np.array([i])
        looks = evenly(looks, LOOKS)
        pictures.append(np.median(np.stack([views.load(int(j)) for j in looks]), axis=0).astype(np.uint8))
        masks = [m for j in looks if (m := mask(int(j))) is not None]
        moves = np.mean(masks, axis=0) >= 0.5 if masks else np.zeros((views.height, views.width), bool)
        static.append(~moves)
    return Plates(frames, pictures, static)
