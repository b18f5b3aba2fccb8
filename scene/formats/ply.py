"""Gaussians of one moment as a PLY file in the layout of 3D Gaussian Splatting (Kerbl et al. 2023), which viewers and editors read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from ...rasterizer import Gaussians
from ...rasterizer.validate import usable

LEAST_ALPHA = 1 / 255  # the rasterizer draws nothing below this
COEFFICIENTS = 16  # of degree 3, which readers of this layout expect


def ply_bytes(gaussians: Gaussians, comments: Sequence[str] = ()) -> tuple[bytes, int]:
    """The file with the visible ones among ``gaussians`` (with sh), and their number. comments: lines of its header. SH has degree 3 and is
    0 above that of ``gaussians``: some readers expect all 45.

    Binary, little-endian float32: x y z (world units), nx ny nz (0), f_dc_0..2 and f_rest_0.. (SH by channel, then coefficient), opacity
    (logit), scale_0..2 (ln of world units), rot_0..3 (w x y z, unit)."""
    shown = seen(gaussians)
    assert shown.sh is not None
    rows, sh = len(shown.means), shown.sh
    sh = torch.cat([sh, sh.new_zeros(rows, COEFFICIENTS - sh.shape[1], 3)], 1)
    logit = torch.logit(shown.opacities.clamp(LEAST_ALPHA / 2, 1 - 1e-6))
    return table_bytes(shown.means, sh, logit, shown.scales.log(), shown.quats, {}, comments), rows


def table_bytes(
    means: Tensor, sh: Tensor, logits: Tensor, log_scales: Tensor, quats: Tensor, more: Mapping[str, Tensor], comments: Sequence[str]
) -> bytes:
    """A PLY file of the columns of `ply_bytes` and, after them, ``more`` [N] by name."""
    rest = sh[:, 1:].transpose(1, 2).reshape(len(sh), 3 * (sh.shape[1] - 1))
    names = [*"xyz", "nx", "ny", "nz", *(f"f_dc_{k}" for k in range(3)), *(f"f_rest_{k}" for k in range(rest.shape[1]))]
    names += ["opacity", *(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4)), *more]
    columns = [means, torch.zeros(len(sh), 3), sh[:, 0], rest, logits[:, None], log_scales, quats, *(one[:, None] for one in more.values())]
    table = torch.cat([column.detach().cpu().float() for column in columns], 1).numpy().astype("<f4")
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {line}" for line in comments), f"element vertex {len(table)}"]
    header += [*(f"property float {n}" for n in names), "end_header"]
    return ("\n".join(header) + "\n").encode() + np.ascontiguousarray(table).tobytes()


def drawable_rows(gaussians: Gaussians) -> Tensor:
    """[N] bool: those that the rasterizer does not leave out for a number that is not finite, or for want of an extent or a rotation.
    Readers would draw them, and one of them spoils the boxes that its neighbours are quantised in."""
    return usable(replace(gaussians, opacities=gaussians.opacities.clamp(0, 1)))


def seen_rows(gaussians: Gaussians) -> Tensor:
    """[N] bool: those of `drawable_rows` that are opaque enough to be drawn."""
    return (gaussians.opacities >= LEAST_ALPHA) & drawable_rows(gaussians)


def seen(gaussians: Gaussians) -> Gaussians:
    """The visible ones among ``gaussians`` (with sh), with unit quats."""
    assert gaussians.sh is not None
    keep = seen_rows(gaussians)
    quats = torch.nn.functional.normalize(gaussians.quats[keep], dim=1)
    return Gaussians(gaussians.means[keep], quats, gaussians.scales[keep], gaussians.opacities[keep], sh=gaussians.sh[keep])


def joined(first: Gaussians, second: Gaussians) -> Gaussians:
    """Both sets as one; their sh must have the same degree."""
    fields = ("means", "quats", "scales", "opacities", "sh")
    return Gaussians(**{name: torch.cat([getattr(first, name), getattr(second, name)]) for name in fields})
