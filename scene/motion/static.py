"""A scene in which nothing moves."""

from __future__ import annotations

from torch import Tensor

from ...rasterizer import Camera
from ..primitives import GaussianSet
from .in_view import in_view
from .interface import Motion
from .times import Time


class Static(Motion):
    """The motion of a scene that has none: all primitives stay at rest."""

    kind = "static"
    static = True
    steady = True
    moving_seeds = False

    def in_view(self, gaussians: GaussianSet, camera: Camera, t: Time | None, tiles: Tensor | None, fuller: float) -> Tensor | None:
        return in_view(gaussians, camera, None, tiles, fuller)
