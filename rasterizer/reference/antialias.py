"""What the antialiased mode does to opacities, sharpness and points before anything is drawn (docs/maths.md, "Antialiased mode")."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ..types import Camera

# From 10 % to 90 % of its height, an edge is 2 ln 9 / kappa wide. A sharp edge seen through a pixel's box is 0.8 pixels wide.
PIXEL_EDGE = 0.8 / (2 * math.log(9))
OFF_CAMERA = 1e-6  # times near
BLUR_WIDE, BLUR_THIN = 2 * math.pi**2 / 3, (math.pi**2 / 6) ** 2


def fade(z: Tensor, near: float) -> Tensor:
    """[n] factor on opacities: 0 at z = near, 1 from 2 near on, smooth between."""
    t = ((z - near) / near).clamp(0, 1)
    return t * t * (3 - 2 * t)


def clip_points(points: Tensor, near: float) -> Tensor:
    """[m, K, 3] points in camera coordinates, those with z < near replaced by points of the hull in the plane z = near.

    Each is replaced by the intersection of the plane with the line from it to the mean of the points in front, which are weighted by
    their distance from the plane. At least one point of every convex must be in front.
    """
    z = points[..., 2:]
    weights = (z - near).clamp(min=0)
    mean = (weights * points).sum(1, keepdim=True) / weights.sum(1, keepdim=True)
    behind = z < near
    gap = torch.where(behind, mean[..., 2:] - z, 1.0)
    moved = points + (near - z) / gap * (mean - points)
    moved = torch.cat([moved[..., :2], torch.full_like(z, near)], -1)
    return torch.where(behind, moved, points)


def keep_off_camera(centroids: Tensor, camera: Camera) -> Tensor:
    """[m, 3] world; a centroid (before clipping) at the camera's centre, which has no view direction, is moved forward a little."""
    with torch.no_grad():
        rotation, translation = camera.cam_from_world[:3, :3], camera.cam_from_world[:3, 3]
        centre, least = -rotation.T @ translation, OFF_CAMERA * camera.near
        on_it = (centroids - centre).norm(dim=-1, keepdim=True) < least
        shift = torch.where(on_it, centre + least * rotation[2] - centroids, 0.0)
    return centroids + shift


def footprint(kappa: Tensor, area: Tensor, perimeter: Tensor, depths: Tensor, focal: Tensor) -> tuple[Tensor, Tensor]:
    """The sharpness [m] limited by a pixel, and the factor [m] on the opacity that keeps the integral of M.

    area, perimeter: [m] of the hulls in the plane (x/z, y/z). depths: [m] z of the centroids. focal: sqrt(fx fy).
    """
    # 1 / limited^2 = 1 / kappa^2 + (c z / f)^2
    t = 1 / (1 + (PIXEL_EDGE * kappa * depths / focal) ** 2)  # (limited / kappa)^2
    # The integral of M is A sqrt(1 + a / x^2 + b / x^4) with x = kappa 2 A / P. The factor is its ratio for the two sharpnesses, written
    # with x^2 = r of the limited one and x^2 = r / t of the other, so that nothing overflows.
    r = t * (kappa * depths * 2 * area / perimeter) ** 2
    share = torch.sqrt((r * r + BLUR_WIDE * t * r + BLUR_THIN * t * t) / (r * r + BLUR_WIDE * r + BLUR_THIN))
    return kappa * torch.sqrt(t), share
