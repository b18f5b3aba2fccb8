"""The reference backend: project both kinds, merge them by depth, blend."""

from __future__ import annotations

import torch
from torch import Tensor

from ..types import TILE, Camera, Convexes, Frame, Gaussians
from .blend import Layers, blend
from .convexes import convex_alphas, project_convexes
from .gaussians import gaussian_alphas, project_gaussians

BLOCK = 1 << 22  # (pixel, primitive) pairs evaluated at a time; bounds the memory if no gradients are kept


def rasterize_reference(
    camera: Camera,
    gaussians: Gaussians,
    convexes: Convexes,
    background: Tensor,
    antialiased: bool = False,
    tiles: Tensor | None = None,
) -> Frame:
    """Render in float64; see `rasterize`. All tensors are float64 on one device; the extras of both kinds have the same width E."""
    splats = project_gaussians(camera, gaussians, antialiased)
    shapes = project_convexes(camera, convexes, antialiased)

    # Gaussians come first and the sort is stable, so at equal depth they stay in front of the convexes.
    depths = torch.cat([splats.depths, shapes.depths])
    order = torch.argsort(depths.detach(), stable=True)
    layers = Layers(
        depths=depths[order],
        colors=torch.cat([splats.colors, shapes.colors])[order],
        extras=torch.cat([splats.extras, shapes.extras])[order],
    )

    pixels = pixel_centres(camera)
    rows = max(1, BLOCK // max(1, len(order)))
    drawn = torch.ones(len(pixels), 1, dtype=torch.bool) if tiles is None else pixels_of(tiles, camera).reshape(-1, 1)
    parts = []
    for some, here in zip(pixels.split(rows), drawn.to(pixels.device).split(rows)):
        alphas = torch.cat([gaussian_alphas(splats, some), convex_alphas(shapes, camera, some)], dim=1)
        alphas = torch.where(here, alphas, 0.0)
        parts.append(blend(alphas[:, order], layers, background))
    blended = torch.stack([part.blended for part in parts]).any(0)

    touched = torch.zeros_like(blended)
    touched[order] = blended
    visible_gaussians = torch.zeros(gaussians.means.shape[0], dtype=torch.bool, device=pixels.device)
    visible_gaussians[splats.index] = touched[: len(splats.index)]
    visible_convexes = torch.zeros(convexes.points.shape[0], dtype=torch.bool, device=pixels.device)
    visible_convexes[shapes.index] = touched[len(splats.index) :]

    image = (camera.height, camera.width)
    return Frame(
        color=torch.cat([part.color for part in parts]).reshape(*image, 3),
        alpha=torch.cat([part.alpha for part in parts]).reshape(image),
        depth=torch.cat([part.depth for part in parts]).reshape(image),
        extras=torch.cat([part.extras for part in parts]).reshape(*image, -1) if layers.extras.shape[1] else pixels.new_zeros(*image, 0),
        visible_gaussians=visible_gaussians,
        visible_convexes=visible_convexes,
    )


def pixels_of(tiles: Tensor, camera: Camera) -> Tensor:
    """[H, W] bool, the pixels in the tiles that are drawn."""
    return tiles.repeat_interleave(TILE, 0).repeat_interleave(TILE, 1)[: camera.height, : camera.width]


def pixel_centres(camera: Camera) -> Tensor:
    """[H W, 2] pixel centres (column + 0.5, row + 0.5), row by row."""
    y, x = torch.meshgrid(
        torch.arange(camera.height, dtype=torch.float64, device=camera.K.device) + 0.5,
        torch.arange(camera.width, dtype=torch.float64, device=camera.K.device) + 0.5,
        indexing="ij",
    )
    return torch.stack([x, y], -1).reshape(-1, 2)
