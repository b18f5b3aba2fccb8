"""Gaussians: from the 3D covariance to the alpha at a pixel (EWA splatting as in 3DGS, with exact support)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..types import Camera, Gaussians
from ..validate import usable
from .antialias import fade
from .sh import colors_of

DILATION = 0.3  # px^2, added to the diagonal of the 2D covariance
PIXEL_VARIANCE = 0.1  # px^2, added instead in the antialiased mode: that of a pixel's box is 1/12 (Mip-Splatting, Yu et al. 2024)


@dataclass(eq=False)
class Splats:
    """The n Gaussians that survive culling, in input order."""

    index: Tensor  # [n] int64, indices in the input
    depths: Tensor  # [n] z of the centre in camera coordinates
    centres: Tensor  # [n, 2] px
    factors: Tensor  # [n, 2, 3] M, px; the 2D covariance is M M^T + d I
    dilation: float  # d, px^2
    opacities: Tensor  # [n]
    colors: Tensor  # [n, 3]
    extras: Tensor  # [n, E]


def rotations(quats: Tensor) -> Tensor:
    """[n, 3, 3] rotation matrices of quaternions (w x y z) with any non-zero norm."""
    # Dividing by the largest component first keeps tiny and huge quaternions in range. It changes neither the result nor its gradient.
    quats = quats / quats.detach().abs().amax(-1, keepdim=True)
    w, x, y, z = (quats / quats.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def project_gaussians(camera: Camera, gaussians: Gaussians, antialiased: bool = False) -> Splats:
    """Cull Gaussians (bad values, centre nearer than `near`) and project the rest."""
    rotation, translation = camera.cam_from_world[:3, :3], camera.cam_from_world[:3, 3]
    with torch.no_grad():
        z = (gaussians.means @ rotation.T + translation)[:, 2]
        index = (usable(gaussians) & (z >= camera.near)).nonzero()[:, 0]

    # From here on, only survivors: a culled primitive is not part of the autograd graph, so its gradient is zero, never NaN.
    means = gaussians.means[index]
    x, y, z = (means @ rotation.T + translation).unbind(-1)
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]

    # J = d(pixel)/d(camera coordinates). Its x/z and y/z are clamped to the field of view widened by 0.3 tan(half the angle),
    # because far outside the image the linearisation is meaningless.
    slope_x = clamp_without_gradient(x / z, camera.width, fx, cx)
    slope_y = clamp_without_gradient(y / z, camera.height, fy, cy)
    zero = torch.zeros_like(z)
    jacobian = torch.stack(
        [torch.stack([fx / z, zero, -fx * slope_x / z], -1), torch.stack([zero, fy / z, -fy * slope_y / z], -1)],
        dim=-2,
    )
    factors = jacobian @ rotation @ rotations(gaussians.quats[index]) * gaussians.scales[index][:, None, :]
    opacities = gaussians.opacities[index]
    if antialiased:
        opacities = opacities * dilation_share(factors) * fade(z, camera.near)
    assert gaussians.extras is not None  # rasterize() has padded them
    return Splats(
        index=index,
        depths=z,
        centres=torch.stack([fx * x / z + cx, fy * y / z + cy], -1),
        factors=factors,
        dilation=PIXEL_VARIANCE if antialiased else DILATION,
        opacities=opacities,
        colors=colors_of(gaussians, index, means, camera),
        extras=gaussians.extras[index],
    )


def clamp_without_gradient(slope: Tensor, size: int, focal: Tensor, principal: Tensor) -> Tensor:
    """[n] slopes clamped to [-c/f - 0.3 t, (size - c)/f + 0.3 t], t = size / (2 f). A clamped slope is a constant without gradient."""
    with torch.no_grad():
        margin = 0.3 * size / (2 * focal)
        low, high = -principal / focal - margin, (size - principal) / focal + margin
        clamped = slope.clamp(low, high)
    return torch.where(clamped == slope, slope, clamped)


def determinant(m1: Tensor, m2: Tensor, dilation: float) -> Tensor:
    """[n] det(M M^T + d I) from the rows of M and d."""
    return torch.linalg.cross(m1, m2).square().sum(-1) + dilation * (m1.square() + m2.square()).sum(-1) + dilation**2


def dilation_share(factors: Tensor) -> Tensor:
    """[n] sqrt(det(M M^T) / det(M M^T + d I)) = |m1 x m2| / sqrt(det) with the d of the antialiased mode: the part of the area that the
    dilation leaves to the Gaussian."""
    m1, m2 = factors.unbind(1)
    return torch.linalg.vector_norm(torch.linalg.cross(m1, m2), dim=-1) / determinant(m1, m2, PIXEL_VARIANCE).sqrt()


def gaussian_alphas(splats: Splats, pixels: Tensor) -> Tensor:
    """[P, n] o exp(-1/2 d^T C^-1 d) at pixels [P, 2], before the cap and the cutoff; d = pixel - centre, C = M M^T + d I.

    With m1, m2 the rows of M, det C = |m1 x m2|^2 + d (|m1|^2 + |m2|^2) + d^2 and
    d^T adj(C) d = |m2 dx - m1 dy|^2 + d (dx^2 + dy^2). Both are sums of squares, so needle-shaped Gaussians suffer no cancellation.
    """
    m1, m2 = splats.factors.unbind(1)
    det = determinant(m1, m2, splats.dilation)
    dx, dy = (pixels[:, None, :] - splats.centres).unbind(-1)
    across = (m2 * dx[..., None] - m1 * dy[..., None]).square().sum(-1)
    return splats.opacities * torch.exp(-0.5 * (across + splats.dilation * (dx * dx + dy * dy)) / det)
