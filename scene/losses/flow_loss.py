"""Edge consistency: the flow that the model renders, how steady it is over unit intervals (Eq. 8), and how well it matches measured flow.

The flow of a primitive is the displacement of its projected centre, blended like a colour in two extra channels. Blending weights
are held fixed, and only dynamic primitives receive gradients: these terms steer the motion, not the geometry.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

import torch
from torch import Tensor

from ...rasterizer import Camera, Convexes, Gaussians, rasterize
from ..model import Model
from ..motion.times import Time

Drawn = TypeVar("Drawn", Gaussians, Convexes)
Moved = tuple[Gaussians, Convexes]


def project(camera: Camera, points: Tensor) -> Tensor:
    """Pixel positions [N, 2] of ``points`` [N, 3] in world units. Depth is clamped to the near plane, so the result is always finite."""
    R, T = camera.cam_from_world[:3, :3], camera.cam_from_world[:3, 3]
    # Rows of coordinates, not columns: a product of three columns takes three times as long.
    x, y, z = R.to(points, non_blocking=True) @ points.T + T.to(points, non_blocking=True)[:, None]
    z = z.clamp(min=camera.near)
    return torch.stack([camera.K[0, 0] * x / z + camera.K[0, 2], camera.K[1, 1] * y / z + camera.K[1, 2]], 1)


def _centres(model: Model, gaussians: Gaussians, convexes: Convexes) -> tuple[Tensor, Tensor]:
    """Centres of both kinds, attached to the motion but not to the rest positions."""
    centres = gaussians.means, convexes.points.mean(1)
    rest = model.gaussians.means, model.convexes.points.mean(1)
    return centres[0] - rest[0] + rest[0].detach(), centres[1] - rest[1] + rest[1].detach()


def _detached(kind: Drawn, extras: Tensor) -> Drawn:
    fixed: dict[str, Any] = {name: value.detach() for name, value in vars(kind).items() if isinstance(value, Tensor)}
    fixed |= {"sh": None, "colors": extras.new_zeros(extras.shape[0], 3), "extras": extras}
    return replace(kind, **fixed)


def _blend(model: Model, camera: Camera, gaussians: Gaussians, convexes: Convexes, extras: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    frame = rasterize(camera, _detached(gaussians, extras[0]), _detached(convexes, extras[1]), antialiased=model.antialiased)
    return frame.extras, frame.alpha.detach()


def rendered_flow(
    model: Model, camera: Camera, t: Time, next_camera: Camera, t_next: Time, only: tuple[Tensor, Tensor] | None = None
) -> tuple[Tensor, Tensor]:
    """Flow [H, W, 2] (u right, v down, px) from ``camera`` at ``t`` to ``next_camera`` at ``t_next``, and alpha [H, W].

    The flow is divided by alpha, so that partly covered pixels have the full flow. only: bool [N] and [M], the Gaussians and convexes to
    draw; all of them if None.
    """
    gaussians, convexes = model.at(t, camera, sh_degree=0)  # flow has no colours
    if only is not None:  # primitives with zero opacity are not drawn
        gaussians = replace(gaussians, opacities=gaussians.opacities * only[0])
        convexes = replace(convexes, opacities=convexes.opacities * only[1])
    return _flow_between(model, camera, (gaussians, convexes), next_camera, model.at(t_next, camera, sh_degree=0))


def _flow_between(model: Model, camera: Camera, now: Moved, next_camera: Camera, later: Moved) -> tuple[Tensor, Tensor]:
    extras = []
    for kind, a, b in zip((model.gaussians, model.convexes), _centres(model, *now), _centres(model, *later)):
        flow = project(next_camera, b) - project(camera, a)
        # Bounded by the image width, so that a single primitive beside the camera cannot dominate the sum.
        flow = flow.clamp(-camera.width, camera.width)
        extras.append(torch.where(kind.dynamic[:, None], flow, flow.detach()))
    flow, alpha = _blend(model, camera, now[0], now[1], (extras[0], extras[1]))
    return flow / alpha.clamp(min=0.05)[..., None], alpha


def interval_loss(model: Model, camera: Camera, t: Time, dt: float, edges: Tensor) -> Tensor:
    """L_interval (Eq. 8): mean over edge pixels of |flow(t + dt) - flow(t)|^2 in px^2, both seen from the same camera.

    edges: [H, W] weight in [0, 1]. The three times t, t + dt, t + 2 dt must lie in [0, 1].
    """
    start, middle, end = (model.at(t + k * dt, camera, sh_degree=0) for k in range(3))
    first, alpha_first = _flow_between(model, camera, start, camera, middle)
    second, alpha_second = _flow_between(model, camera, middle, camera, end)
    weight = edges * (alpha_first > 0.5) * (alpha_second > 0.5)
    return ((second - first).square().sum(-1) * weight).sum() / weight.sum().clamp(min=1.0)


def data_flow_loss(model: Model, camera: Camera, t: Time, next_camera: Camera, t_next: Time, measured: Tensor, weight: Tensor) -> Tensor:
    """Rendered against measured flow [H, W, 2] px: mean Charbonnier distance over pixels of ``weight`` [H, W] (edges times confidence)."""
    flow, alpha = rendered_flow(model, camera, t, next_camera, t_next)
    weight = weight * (alpha > 0.5)
    distance = torch.sqrt((flow - measured).square().sum(-1) + 1e-2)
    return (distance * weight).sum() / weight.sum().clamp(min=1.0)
