"""Rendered against measured depth: where a plane sweep between cameras has told how far away a place is, surfaces should lie there.

Few cameras leave depth open: what is right for them, painted on the wrong surface, is wrong for the views between them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from torch import Tensor
from torch.nn.functional import interpolate

COVERED = 0.5  # alpha from which there is a surface
LARGEST = 0.2  # of unit / depth: a difference beyond it is taken for a wrong measurement, and pulls no more


class MeasuredDepth:
    """What stands still before each camera.

    inverse: by frame, [h, w] float32, 1 / world units, 0 where nothing is known; frames may share one. unit: the viewing distance, world
    units. moving(i): [h, w] bool of any size, what passes before it in frame i; None where nothing does.
    """

    def __init__(self, inverse: Mapping[int, Tensor], unit: float, moving: Callable[[int], Tensor | None] = lambda i: None) -> None:
        self._maps, self.unit, self._moving = inverse, unit, moving
        self._sized: dict[tuple[int, int, int], Tensor] = {}

    def of(self, frame: int, height: int, width: int) -> Tensor | None:
        """The map of ``frame`` at this size, [height, width]; None where it has none."""
        found = self._maps.get(frame)
        if found is None:
            return None
        key = id(found), height, width
        if key not in self._sized:
            self._sized[key] = interpolate(found[None, None], (height, width), mode="nearest")[0, 0]
        return self._sized[key]

    def loss(self, depth: Tensor, alpha: Tensor, frame: int) -> Tensor:
        """Mean over the picture of the difference in ``unit`` / depth where it is known, at most `LARGEST` each.

        depth [H, W]: alpha-weighted mean z, world units. alpha [H, W]. frame: the number of the one that it was rendered for.
        """
        measured = self.of(frame, *depth.shape)
        if measured is None:
            return depth.new_zeros(())
        known = (measured > 0) & (alpha.detach() > COVERED) & (depth.detach() > 1e-3 * self.unit)
        moving = self._moving(frame)
        if moving is not None:
            known &= interpolate(moving[None, None].float(), depth.shape, mode="nearest")[0, 0] == 0
        inverse = alpha.clamp(min=COVERED) / depth.clamp(min=1e-3 * self.unit)
        off = (self.unit * (inverse - measured)).abs().clamp(max=LARGEST)
        return torch.where(known, off, 0.0).mean()
