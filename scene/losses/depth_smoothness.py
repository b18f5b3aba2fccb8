"""Surfaces should be smooth where the picture is: textureless walls leave depth undetermined, and training fills it with noise."""

from __future__ import annotations

import torch
from torch import Tensor

EDGE = 0.02  # change of colour between neighbours that lets the surface bend e times as easily
USUAL_WIDTH = 320  # px
COVERED = 0.5  # alpha from which there is a surface


def depth_smoothness(depth: Tensor, alpha: Tensor, image: Tensor, unit: float) -> Tensor:
    """Mean absolute second difference of ``unit`` / depth between neighbouring pixels, in x and y, weighted down where ``image`` changes.

    depth [H, W]: alpha-weighted mean z in world units, as the rasterizer returns it. alpha [H, W]. image [H, W, 3] in [0, 1]: the target.
    The inverse depth of a plane is linear in image coordinates, so planes cost nothing at any orientation. A fold covers a fraction
    1 / width of the pixels, so the mean is multiplied by the width in units of 320 px; a fold then counts the same at any image size.
    """
    inverse = unit * alpha.clamp(min=COVERED) / depth.clamp(min=1e-3 * unit)
    solid = (alpha.detach() > COVERED) & (depth.detach() > 1e-3 * unit)
    total = depth.new_zeros(())
    for axis in (0, 1):
        size = depth.shape[axis]
        if size < 3:
            continue
        before, here, after = (inverse.narrow(axis, k, size - 2) for k in range(3))
        counts = solid.narrow(axis, 0, size - 2) & solid.narrow(axis, 1, size - 2) & solid.narrow(axis, 2, size - 2)
        colour = torch.maximum(*((image.narrow(axis, k, size - 2) - image.narrow(axis, 1, size - 2)).abs().amax(-1) for k in (0, 2)))
        bend = (before - 2 * here + after).abs() * torch.exp(-colour / EDGE)
        total = total + torch.where(counts, bend, 0.0).mean()
    return total * (depth.shape[1] / USUAL_WIDTH)
