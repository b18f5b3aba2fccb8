"""Rendered against given depth: what moves should stay where the capture's own depth shows it.

One camera at one time fits a moving surface at any depth, so its primitives drift along the rays unless something holds them. What holds
them is a map for each frame, with a confidence for each pixel.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from .measured_depth import COVERED
from .photometric import scale_gradient

LARGEST = 0.5  # of unit / depth: what is farther off is pulled no more strongly, and a wrong map cannot outweigh the picture


class HeldDepth:
    """Depth of what moves, by frame.

    maps: maps a frame to [2, h, w] float32: inverse depth in 1 / world units, 0 where nothing is held, and its confidence in [0, 1].
    unit: the viewing distance, world units.
    """

    def __init__(self, maps: Mapping[int, Tensor], unit: float) -> None:
        self._maps, self.unit = maps, unit

    def of(self, frame: int, height: int, width: int) -> Tensor | None:
        """The map of ``frame`` resized to [2, height, width]; None if it has none."""
        found = self._maps.get(frame)
        if found is None:
            return None
        return interpolate(found[None], (height, width), mode="nearest")[0]


def held_depth_difference(depth: Tensor, alpha: Tensor, held: Tensor, unit: float, weight: Tensor | None = None) -> Tensor:
    """Mean over the image of the absolute difference in ``unit`` / depth times its confidence; 0 where nothing is held.

    depth [H, W]: alpha-weighted mean z, world units. alpha [H, W]. held [2, H, W]: see `HeldDepth.of`. weight [H, W]: factor on each
    pixel's gradient, but not on its loss; None: 1 everywhere.
    """
    if weight is not None:
        depth, alpha = scale_gradient(depth, weight), scale_gradient(alpha, weight)
    inverse, confidence = held
    known = (inverse > 0) & (alpha.detach() > COVERED) & (depth.detach() > 1e-3 * unit)
    off = (unit * (alpha.clamp(min=COVERED) / depth.clamp(min=1e-3 * unit) - inverse)).abs()
    return torch.where(known, confidence * off.clamp(max=LARGEST), 0.0).mean()
