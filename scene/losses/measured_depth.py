"""Rendered against measured depth: surfaces should lie where a plane sweep between cameras found them.

A small number of cameras leaves depth ambiguous: colours painted on the wrong surface can fit these cameras and still be wrong in the views
between them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from torch import Tensor
from torch.nn.functional import interpolate

COVERED = 0.5  # alpha from which there is a surface
LARGEST = 0.2  # of unit / depth: larger differences are treated as wrong measurements and have no gradient


class MeasuredDepth:
    """Depth of the static scene in front of each camera.

    inverse: maps a frame to its inverse depth [h, w] float32 in 1 / world units, 0 where it is unknown; frames may share a map. unit: the
    viewing distance, world units. moving(i): [h, w] bool of any size, the pixels of frame i that show something moving; None if there are
    none.
    """

    def __init__(self, inverse: Mapping[int, Tensor], unit: float, moving: Callable[[int], Tensor | None] = lambda i: None) -> None:
        self._maps, self.unit, self._moving = inverse, unit, moving
        self._sized: dict[tuple[int, int, int], Tensor] = {}

    def of(self, frame: int, height: int, width: int) -> Tensor | None:
        """The map of ``frame`` resized to [height, width]; None if the frame has no map."""
        found = self._maps.get(frame)
        if found is None:
            return None
        key = id(found), height, width
        if key not in self._sized:
            self._sized[key] = interpolate(found[None, None], (height, width), mode="nearest")[0, 0]
        return self._sized[key]

    def static(self, frame: int, height: int, width: int) -> Tensor | None:
        """`of`, with 0 where `moving` says that it does not count."""
        found, moving = self.of(frame, height, width), self.moving(frame)
        if found is None or moving is None:
            return found
        return torch.where(interpolate(moving[None, None].float(), (height, width), mode="nearest")[0, 0] == 0, found, 0.0)

    def moving(self, frame: int) -> Tensor | None:
        """[h, w] bool, the pixels of ``frame`` that show something moving, where `of` does not count; None if there are none."""
        return self._moving(frame)


def depth_difference(depth: Tensor, alpha: Tensor, measured: Tensor, moving: Tensor | None, unit: float) -> Tensor:
    """Mean over the image of the absolute difference in ``unit`` / depth, at most `LARGEST` a pixel and 0 where it is unknown.

    depth [H, W]: alpha-weighted mean z, world units. alpha [H, W]. measured [H, W]: see `MeasuredDepth.of`; moving [h, w]: see
    `MeasuredDepth.moving`. Plain torch: the kernel's oracle.
    """
    known = (measured > 0) & (alpha.detach() > COVERED) & (depth.detach() > 1e-3 * unit)
    if moving is not None:
        known &= interpolate(moving[None, None].float(), depth.shape, mode="nearest")[0, 0] == 0
    inverse = alpha.clamp(min=COVERED) / depth.clamp(min=1e-3 * unit)
    off = (unit * (inverse - measured)).abs().clamp(max=LARGEST)
    return torch.where(known, off, 0.0).mean()
