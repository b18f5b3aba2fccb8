"""How far a graph of control nodes is from moving rigidly."""

from __future__ import annotations

import torch
from torch import Tensor

from ...rotation import rotate


def strain(positions: Tensor, graph: Tensor, turns: Tensor, shifts: Tensor) -> Tensor:
    """How far edges are from turning with the node that they start from, relative to their lengths: a mean over all edges, a scalar.

    positions [B, 3] at rest. graph [B, k]: the nodes to which each one's edges lead. turns [B, 4] unit quaternions (w x y z) and shifts
    [B, 3] of the nodes.
    """
    if len(positions) < 2:
        return torch.zeros((), device=positions.device)
    at_rest = positions[graph] - positions[:, None]
    turns = turns[:, None].expand(*graph.shape, 4).reshape(-1, 4)
    turned = rotate(turns, at_rest.reshape(-1, 3)).reshape(at_rest.shape)
    now = positions + shifts
    strained = (now[graph] - now[:, None] - turned).norm(dim=2) / at_rest.norm(dim=2).clamp(min=1e-6)
    return strained.mean()
