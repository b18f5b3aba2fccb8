"""Penalises the spread in depth of what contributes to one pixel: fog in place of a surface can fit every training view and no other.

The colours of fog depend on the viewpoint in a way that those of a solid surface do not, so fog can fit a small number of views more
closely than the surface can. It becomes visible between those views and beside the object. The distortion loss of Mip-NeRF 360 (Barron
et al. 2022, Eq. 15) has the same aim; this loss is the standard deviation along the ray, which pulls equally over short and long distances.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ...rasterizer import Camera, Convexes, Gaussians
from ..model import Model
from .photometric import scale_gradient
from .term import Now, Rendered, Term

EVERY = 4  # steps between two evaluations
BEGIN = 0.1  # fraction of all steps; there are no surfaces before
FLOOR = 1e-4  # of unit: smaller spreads count as zero, and the gradient of the square root stays finite


class DepthSpread(Term):
    """`depth_spread`, from two extra channels of the render."""

    name, setting, every = "depth spread", "spread", EVERY

    def due(self, model: Model, now: Now) -> bool:
        return self.weight > 0 and now.number > BEGIN * self.run.total

    def shapes(self, camera: Camera, gaussians: Gaussians, convexes: Convexes) -> tuple[Gaussians, Convexes]:
        return with_depth(camera, gaussians, convexes, self.run.unit)

    def value(self, rendered: Rendered, inputs: Any) -> Tensor:
        frame = rendered.frame
        return self.weight * rendered.share * depth_spread(frame.extras, frame.alpha, rendered.weight)


def with_depth(camera: Camera, gaussians: Gaussians, convexes: Convexes, unit: float) -> tuple[Gaussians, Convexes]:
    """Both kinds with two extras: z in units of ``unit``, relative to the mean of the Gaussians, and its square. For a Gaussian they are
    taken at its centre. For a convex they are means over its points, because parts that stick out behind an opaque front are invisible in
    the training views but not in others."""
    pose = camera.cam_from_world.to(gaussians.means, non_blocking=True)
    depths = [points @ pose[2, :3] + pose[2, 3] for points in (gaussians.means[:, None], convexes.points)]
    origin = depths[0].detach().mean() if len(depths[0]) else 0.0
    extras = [torch.stack([z.mean(1), z.square().mean(1)], 1) for z in ((depth - origin) / unit for depth in depths)]
    return replace(gaussians, extras=extras[0]), replace(convexes, extras=extras[1])


def depth_spread(extras: Tensor, alpha: Tensor, weight: Tensor | None = None) -> Tensor:
    """Mean over pixels of the standard deviation of z, in units of the ``unit`` of `with_depth`, times the square root of alpha.

    extras [H, W, 2], alpha [H, W]: rendered from what `with_depth` returns. weight: [H, W] float32, factor on each pixel's gradient, but
    not on its loss; None: 1 everywhere.
    """
    if weight is not None:
        extras, alpha = scale_gradient(extras, weight[..., None]), scale_gradient(alpha, weight)
    first, second = extras.unbind(-1)
    variance = second - first.square() / alpha.clamp(min=1e-3)
    return (variance.clamp(min=0) + FLOOR**2).sqrt().mean() - FLOOR
