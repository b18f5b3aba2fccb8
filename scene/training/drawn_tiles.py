"""Which tiles of the image a training step draws: what moves, and a random share of what never changes in front of a fixed camera.

A pixel that never changes shows the same at all times, so a step at each of them learns the same thing again: training takes longer, and
the static scene is fitted ever more closely to a few cameras. Moving objects, which differ at each time, need many more steps.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

from ...rasterizer import TILE
from ..views import Views

LEAST_SHARE = 0.25  # of the static tiles that a step draws
STATIC_STEPS = 2000  # in which a static tile is drawn on average, if there are as many; with fewer, static parts are badly shown
SIDE = 4  # tiles along the side of a block of static tiles that is drawn as a whole
LEAST_TIMES = 8  # times of a camera from which its static pixels are seen often enough
MOST_DRAWN = 0.9  # with a larger expected share of the image, all of it is drawn


class Drawn(NamedTuple):
    """weight [rows, columns] float32: 0 for tiles that are not drawn, else the factor on the gradient of its pixels with which the
    gradient's expected value is that of drawing everything."""

    weight: Tensor

    @property
    def tiles(self) -> Tensor:
        """[rows, columns] bool, as `rasterize` takes them."""
        return self.weight > 0

    def pixels(self, like: Tensor) -> Tensor:
        """The weight of each pixel, [H, W] as those of ``like`` [H, W, ...] and on its device."""
        height, width = like.shape[:2]
        wide = self.weight.to(like.device, non_blocking=True)[:, None, :, None].expand(-1, TILE, -1, TILE)
        return wide.reshape(TILE * self.weight.shape[0], -1)[:height, :width].contiguous()


class DrawnTiles:
    """steps: of the whole training. Where it is unknown what moves, and for cameras that see few times, every step draws everything."""

    def __init__(self, views: Views, seed: int, steps: int) -> None:
        self.views, self.seed = views, seed
        self.share = min(max(STATIC_STEPS / max(steps, 1), LEAST_SHARE), 1.0)
        cameras, times = np.unique(views.camera[views.train], return_counts=True)
        self.often = {int(camera) for camera, count in zip(cameras, times) if count >= LEAST_TIMES}
        self._moving: dict[tuple[int, float], np.ndarray] = {}

    def of(self, frame: int, scale: float, step: int) -> Drawn | None:
        """What step ``step`` draws of ``frame`` at ``scale``; None: everything."""
        if self.views.load_moving is None or int(self.views.camera[frame]) not in self.often:
            return None
        moving = self.moving(frame, scale)
        if moving.mean() + self.share * (1 - moving.mean()) > MOST_DRAWN:
            return None
        rows, columns = moving.shape
        blocks = np.random.default_rng((self.seed, 3, step)).random((-(-rows // SIDE), -(-columns // SIDE))) < self.share
        chosen = spread(blocks, SIDE)[:rows, :columns]
        return Drawn(torch.from_numpy(np.where(moving, 1.0, chosen / self.share).astype(np.float32)))

    def moving(self, frame: int, scale: float) -> np.ndarray:
        """[rows, columns] bool, the tiles of ``frame`` at ``scale`` in which something moves."""
        if (frame, scale) not in self._moving:
            assert self.views.load_moving is not None
            width, height = self.views.size(scale)
            whole = np.zeros((-(-height // TILE) * TILE, -(-width // TILE) * TILE), bool)
            whole[:height, :width] = cv2.resize(self.views.load_moving(frame), (width, height), interpolation=cv2.INTER_AREA) > 0
            self._moving[frame, scale] = np.asarray(whole.reshape(whole.shape[0] // TILE, TILE, -1, TILE).any((1, 3)))
        return self._moving[frame, scale]


def spread(squares: np.ndarray, side: int) -> np.ndarray:
    """Each value repeated over ``side`` rows and columns."""
    return squares.repeat(side, 0).repeat(side, 1)
