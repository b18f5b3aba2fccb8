"""Rotations as quaternions (w x y z)."""

from __future__ import annotations

import torch
from torch import Tensor


def rotate(quats: Tensor, vectors: Tensor) -> Tensor:
    """``vectors`` [N, 3] rotated by unit quaternions [N, 4]; the identity leaves them bit-equal."""
    axis = quats[:, 1:]
    twice = 2 * torch.linalg.cross(axis, vectors)
    return vectors + quats[:, :1] * twice + torch.linalg.cross(axis, twice)


def compose(first: Tensor, second: Tensor) -> Tensor:
    """Quaternions [N, 4] that rotate by ``second`` and then by ``first``."""
    a, b, c, d = first.unbind(1)
    w, x, y, z = second.unbind(1)
    product = [a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y, a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w]
    return torch.stack(product, 1)


def quats_to_matrices(quats: Tensor) -> Tensor:
    """Rotation matrices [N, 3, 3] of quaternions [N, 4] (any nonzero norm)."""
    return unit_matrices(torch.nn.functional.normalize(quats, dim=1))


def unit_matrices(quats: Tensor) -> Tensor:
    """Rotation matrices [N, 3, 3] of unit quaternions [N, 4]."""
    w, x, y, z = quats.unbind(1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, 1).view(-1, 3, 3)
