"""View-dependent colour from real spherical harmonics up to degree 3, with the basis and signs of 3DGS."""

from __future__ import annotations

import torch
from torch import Tensor

from ..types import Camera, Convexes, Gaussians


def sh_basis(directions: Tensor, coefficients: int) -> Tensor:
    """[N, C] values of the first C = 1, 4, 9 or 16 basis functions at unit directions [N, 3]."""
    x, y, z = directions.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    functions = [torch.full_like(x, 0.28209479177387814)]
    if coefficients > 1:
        functions += [-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x]
    if coefficients > 4:
        functions += [
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (2 * zz - xx - yy),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (xx - yy),
        ]
    if coefficients > 9:
        functions += [
            -0.5900435899266435 * y * (3 * xx - yy),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * zz - xx - yy),
            0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
            -0.4570457994644658 * x * (4 * zz - xx - yy),
            1.445305721320277 * z * (xx - yy),
            -0.5900435899266435 * x * (xx - 3 * yy),
        ]
    return torch.stack(functions, -1)


def colors_of(owner: Gaussians | Convexes, index: Tensor, centres: Tensor, camera: Camera) -> Tensor:
    """[n, 3] colours of the primitives `index`: either `colors` unchanged, or SH in the view direction, plus 0.5, clamped at 0.

    centres: [n, 3] world positions (centre or centroid). The view direction points from the camera's centre -R^T t to them.
    No gradient flows through a clamped colour.
    """
    if owner.colors is not None:
        return owner.colors[index]
    assert owner.sh is not None  # rasterize() has checked that exactly one is given
    sh = owner.sh[index]
    rotation, translation = camera.cam_from_world[:3, :3], camera.cam_from_world[:3, 3]
    directions = torch.nn.functional.normalize(centres + rotation.T @ translation, dim=-1)
    raw = torch.einsum("nc,ncd->nd", sh_basis(directions, sh.shape[1]), sh) + 0.5
    return torch.where(raw > 0, raw, 0.0)
