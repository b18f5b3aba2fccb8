"""Finds Gaussians that no training view sees because others are in front of them.

Seeds fill a whole silhouette, and Gaussians behind a surface help to colour it as long as it is not quite opaque. The surface is then fog
spread out in depth: training views look right, but views from elsewhere, which look past the surface or on another background, show what is
behind it. Removing the hidden Gaussians early enough lets training make the surface opaque instead.
"""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from ....rasterizer import Camera, Gaussians, rasterize
from ....rasterizer.reference.gaussians import DILATION
from ...model import Model
from ...rotation import quats_to_matrices
from ...views import Views, inside_image

LEAST = 0.05  # px; smaller footprints are not judged


def seen_share(model: Model, views: Views, frames: list[int], move: bool, scale: float = 1.0) -> Tensor:
    """[N] share of each Gaussian's own footprint that reaches the camera, in whichever of ``frames`` sees most of it.

    Infinite for those that no frame could see. A Gaussian in front of everything else has 1; one behind surfaces of opacity a has 1 - a.
    The blending weight is measured as in `density.measure_responsibility` and divided by `footprint`.
    """
    count, device = len(model.gaussians), model.device
    best = torch.full((count,), -1.0, device=device)
    nothing = torch.zeros(3)
    for i in frames:
        camera = views.rasterizer_camera(i, scale)
        with torch.no_grad():
            gaussians, convexes = model.at(views.moment(i), camera, move)
        probe = torch.zeros(count, 1, device=device, requires_grad=True)
        frame = rasterize(camera, replace(gaussians, extras=probe), convexes, nothing, antialiased=model.antialiased)
        (weight,) = torch.autograd.grad(frame.extras, probe, torch.ones_like(frame.extras))
        with torch.no_grad():
            own = footprint(camera, gaussians, 0.0 if model.antialiased else DILATION)
            judged = inside_image(camera, gaussians.means) & (own > LEAST)
            best = torch.where(judged, torch.maximum(best, weight[:, 0] / own.clamp(min=LEAST)), best)
    return torch.where(best < 0, torch.inf, best)


def footprint(camera: Camera, gaussians: Gaussians, dilation: float = DILATION) -> Tensor:
    """[N] px: the sum of each Gaussian's alpha over an image of that Gaussian alone, 2 pi o sqrt(det S) with opacity o and projected
    covariance S (Zwicker et al. 2001), for centres in front of the camera. dilation: px^2 added to S; none in the antialiased mode."""
    R, T = (part.to(gaussians.means) for part in (camera.cam_from_world[:3, :3], camera.cam_from_world[:3, 3]))
    fx, fy = float(camera.K[0, 0]), float(camera.K[1, 1])
    x, y, z = (gaussians.means @ R.T + T).unbind(1)
    z = z.clamp(min=camera.near)
    axes = R @ (quats_to_matrices(gaussians.quats) * gaussians.scales[:, None])  # [N, 3, 3], a principal axis in each column
    across = fx / z[:, None] * (axes[:, 0] - (x / z)[:, None] * axes[:, 2])
    down = fy / z[:, None] * (axes[:, 1] - (y / z)[:, None] * axes[:, 2])
    a, b, c = across.square().sum(1) + dilation, (across * down).sum(1), down.square().sum(1) + dilation
    return 2 * math.pi * gaussians.opacities * (a * c - b * b).clamp(min=1e-12).sqrt()
