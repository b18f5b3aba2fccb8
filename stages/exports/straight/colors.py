"""Colours that fit into `.4dgs`, whose mean colours lie in [0, 1]: what is beyond is told by the bands of SH instead."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ....rasterizer.reference.sh import sh_basis
from ....scene.formats.pieces import Pieces
from ....scene.primitives import SH_C0

DEGREE = 2  # of SH, at least, where a colour is beyond; a third degree costs more by its rounding than it gains
BEYOND = 0.5 / 255  # of [0, 1], from which a colour is told otherwise
RIDGE = 1e-3  # keeps coefficients small where cameras on all sides leave no bands that look constant
CHUNK = 1 << 14  # pieces at a time


def fitting_colors(pieces: Pieces, eyes: Tensor) -> Pieces:
    """``pieces`` with mean colours in [0, 1] that look the same from ``eyes`` [V, 3], the places of the capture's cameras.

    Training makes colours beyond [0, 1] where Gaussians are few or faint. The part beyond is constant over directions, and bands of SH that
    are constant over the directions of ``eyes`` alone take it over (least squares). From other sides, or with cameras on all sides, it is
    lost, as it was in the file before.
    """
    look = pieces.gaussians
    assert look.sh is not None
    colors = 0.5 + SH_C0 * look.sh[:, 0].double()
    beyond = colors - colors.clamp(0, 1)
    index = (beyond.abs().amax(1) > BEYOND).nonzero()[:, 0]
    if not len(index):
        return pieces
    bands = max(look.sh.shape[1], (DEGREE + 1) ** 2)
    sh = torch.cat([look.sh, look.sh.new_zeros(len(look.sh), bands - look.sh.shape[1], 3)], 1)
    sh[index, 0] = ((colors[index].clamp(0, 1) - 0.5) / SH_C0).to(sh)
    for some in index.split(CHUNK):
        sh[some, 1:] += (constant_bands(look.means[some], eyes, bands)[:, :, None] * beyond[some][:, None]).to(sh)
    return replace(pieces, gaussians=replace(look, sh=sh))


def constant_bands(means: Tensor, eyes: Tensor, bands: int) -> Tensor:
    """[n, bands - 1] coefficients of SH without the first that give about 1 in the directions from ``eyes`` [V, 3] to ``means`` [n, 3]."""
    directions = torch.nn.functional.normalize(means.double()[:, None] - eyes.double(), dim=2)
    basis = sh_basis(directions.reshape(-1, 3), bands).reshape(len(means), len(eyes), bands)[..., 1:]
    square = basis.transpose(1, 2) @ basis / len(eyes) + RIDGE * torch.eye(bands - 1).double()
    return torch.linalg.solve(square, basis.mean(1))
