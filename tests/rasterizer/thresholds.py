"""Which pixels of a render are decided by a threshold.

At some pixels, rounding decides on which side of a threshold a value lies: an alpha within a rounding error of 1/255 or of the cap, a
transmittance at the stop, two layers at the same depth. There, both results are correct and may differ by as much as one layer.
Everywhere else they agree tightly.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from e4dgs.rasterizer.reference.blend import MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE, effective_alphas
from e4dgs.rasterizer.reference.convexes import Shapes, convex_alphas, project_convexes
from e4dgs.rasterizer.reference.gaussians import Splats, gaussian_alphas, project_gaussians
from e4dgs.rasterizer.reference.render import pixel_centres
from e4dgs.rasterizer.reference.scene import Scene
from e4dgs.rasterizer.types import Camera
from e4dgs.rasterizer.uniform import cast, no_convexes, no_gaussians, pad_extras
from torch import Tensor

ALPHA_BAND = 2e-5  # absolute
STOP_BAND = 1e-3  # relative
DEPTH_BAND = 1e-6  # relative


@torch.no_grad()
def projected(scene: Scene) -> tuple[Camera, Splats, Shapes]:
    """The scene's camera and its projected primitives from the reference, in float64 and without extras."""
    camera = cast(scene.camera, torch.float64)
    gaussians = cast(scene.gaussians or no_gaussians(camera.K.dtype, camera.K.device), torch.float64)
    convexes = cast(scene.convexes or no_convexes(camera.K.dtype, camera.K.device), torch.float64)
    gaussians, convexes = pad_extras(replace(gaussians, extras=None), replace(convexes, extras=None))
    return camera, project_gaussians(camera, gaussians, scene.antialiased), project_convexes(camera, convexes, scene.antialiased)


def raw_alphas(scene: Scene) -> tuple[Tensor, Tensor]:
    """Alphas [H W, n] before the cap and the cutoff at 1/255, and depths [n], front to back, from the reference."""
    camera, splats, shapes = projected(scene)
    with torch.no_grad():
        pixels = pixel_centres(camera)
        depths = torch.cat([splats.depths, shapes.depths])
        order = torch.argsort(depths, stable=True)
        return torch.cat([gaussian_alphas(splats, pixels), convex_alphas(shapes, camera, pixels)], 1)[:, order], depths[order]


def decided_by_threshold(
    scene: Scene, alpha_band: float = ALPHA_BAND, stop_band: float = STOP_BAND, depth_band: float = DEPTH_BAND
) -> Tensor:
    """[H, W] bool: pixels where some primitive is so close to a threshold (within the band) that rounding may decide."""
    raw, depths = raw_alphas(scene)
    _, blended = effective_alphas(raw)
    capped = raw.clamp(max=MAX_ALPHA)
    after = torch.cumprod(1 - torch.where(raw >= MIN_ALPHA, capped, 0.0), dim=1)  # as if no pixel ever stopped
    before = torch.cat([torch.ones_like(after[:, :1]), after], 1)[:, :-1]
    reached = before >= MIN_TRANSMITTANCE * (1 - stop_band)  # layers behind the stop do not matter
    near = ((raw - MIN_ALPHA).abs() < alpha_band) | ((raw - MAX_ALPHA).abs() < alpha_band)
    near |= (raw >= MIN_ALPHA) & ((after / MIN_TRANSMITTANCE - 1).abs() < stop_band)
    undecided = (near & reached).any(1)
    ties = (depths[1:] - depths[:-1]) < depth_band * depths[1:]
    undecided |= (blended[:, 1:] & blended[:, :-1] & ties).any(1)
    return undecided.reshape(scene.camera.height, scene.camera.width)
