"""How an object moves: a sum of simple terms that gives an exact affine pose for any time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """world_from_object(t) for t in [0,1]: squash, then turn, then place.

    centre: position at t = 0.5 without bounces. slide: path from t = 0 to t = 1. turn: radians about `axis` over the whole
    time. bounce: height of `bounces` parabolas in z. squash: the object's z grows by exp(squash sin 2 pi t) while x and y
    shrink so that the volume stays (the one term that is not rigid).
    """

    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    slide: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    turn: float = 0.0
    rest_angle: float = 0.0
    bounce: float = 0.0
    bounces: int = 2
    squash: float = 0.0

    @property
    def moves(self) -> bool:
        return bool(np.any(self.slide) or self.turn or self.bounce or self.squash)

    def world_from_object(self, time: float) -> Array:
        """[4,4] affine."""
        phase = (self.bounces * time) % 1.0
        offset = np.asarray(self.centre) + np.asarray(self.slide) * (time - 0.5)
        offset[2] += self.bounce * 4.0 * phase * (1.0 - phase)
        stretch = np.exp(self.squash * np.sin(2.0 * np.pi * time))
        scale = np.array([stretch**-0.5, stretch**-0.5, stretch])
        pose = np.eye(4)
        pose[:3, :3] = rotation_about(self.axis, self.rest_angle + self.turn * time) * scale
        pose[:3, 3] = offset
        return pose


def rotation_about(axis: tuple[float, float, float], angle: float) -> Array:
    """[3,3] rotation by Rodrigues' formula; the axis need not have length 1."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)
