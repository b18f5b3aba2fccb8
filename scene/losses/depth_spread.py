"""How far apart in depth lies what one pixel shows: a surface that is a fog can please every training view and no other.

The colours of a fog depend on where one looks from, as nothing solid does, so few views can be fitted by it more closely than by the
surface. Between them, and beside the object, it shows. The same aim has the distortion of Mip-NeRF 360 (Barron et al. 2022, Eq. 15); here
it is the standard deviation along the ray, which pulls as much over short distances as over long ones.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ...rasterizer import Camera, Convexes, Gaussians

EVERY = 4  # steps between two evaluations, whose weight makes up for it
BEGIN = 0.1  # of all steps: before, there are no surfaces yet
FLOOR = 1e-4  # of unit: a spread below it is none, and its square root has a gradient


def with_depth(camera: Camera, gaussians: Gaussians, convexes: Convexes, unit: float) -> tuple[Gaussians, Convexes]:
    """Both kinds with two extras: z in units of ``unit``, from the mean of the Gaussians, and its square; of a Gaussian at its centre, of a
    convex as means over its points: what sticks out behind an opaque front shows in no training view, but in others."""
    pose = camera.cam_from_world.to(gaussians.means)
    depths = [points @ pose[2, :3] + pose[2, 3] for points in (gaussians.means[:, None], convexes.points)]
    origin = depths[0].detach().mean() if len(depths[0]) else 0.0
    extras = [torch.stack([z.mean(1), z.square().mean(1)], 1) for z in ((depth - origin) / unit for depth in depths)]
    return replace(gaussians, extras=extras[0]), replace(convexes, extras=extras[1])


def depth_spread(extras: Tensor, alpha: Tensor) -> Tensor:
    """Mean over the pixels of the standard deviation of z, in ``unit`` of `with_depth`, times the root of alpha.

    extras [H, W, 2], alpha [H, W]: as rendered of what `with_depth` returns.
    """
    first, second = extras.unbind(-1)
    variance = second - first.square() / alpha.clamp(min=1e-3)
    return (variance.clamp(min=0) + FLOOR**2).sqrt().mean() - FLOOR
