"""Gaussians that are split: which, and into what. In space by default; in time where the same place must look different at other times."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from ...primitives import GaussianSet
from ...rotation import quats_to_matrices


def choose_to_split(gaussians: GaussianSet, error: Tensor, count: int) -> Tensor:
    """Indices of the ``count`` Gaussians with the largest attributed ``error`` [N]; those that no probed pixel saw are never chosen."""
    count = min(count, int((error > 0).sum()))
    return error.topk(count).indices.sort().values if count > 0 else torch.zeros(0, dtype=torch.long, device=error.device)


def split(
    gaussians: GaussianSet,
    in_space: Tensor,
    in_time: Tensor | None = None,
    halves_in_time: Callable[[GaussianSet], list[GaussianSet]] = lambda parents: [],
) -> tuple[GaussianSet, Tensor]:
    """Split each Gaussian of the indices ``in_space`` into two along its longest axis, and each of ``in_time`` as ``halves_in_time`` does;
    the others stay. Returns the new set and, for each of its rows, the old row whose optimiser state it keeps (-1 for children)."""
    halves = along_longest_axis(gaussians.select(in_space))
    kept = torch.ones(len(gaussians), dtype=torch.bool, device=gaussians.device)
    kept[in_space] = False
    if in_time is not None and len(in_time):
        halves += halves_in_time(gaussians.select(in_time))
        kept[in_time] = False
    rest = kept.nonzero()[:, 0]
    made = GaussianSet.joined([gaussians.select(rest), *halves])
    return made, torch.cat([rest, rest.new_full((len(made) - len(rest),), -1)])


@torch.no_grad()
def along_longest_axis(parents: GaussianSet) -> list[GaussianSet]:
    """The halves of ``parents``. They lie half a standard deviation to either side. Their longest axis shrinks to 0.6 and the others to
    0.9, and their opacity is 1 - sqrt(1 - o), so that two of them stacked are as opaque as their parent."""
    p = parents.parameters
    axis = p["log_scales"].argmax(1)
    rows = torch.arange(len(parents), device=axis.device)
    offset = quats_to_matrices(p["quats"])[rows, :, axis] * (0.5 * p["log_scales"][rows, axis].exp())[:, None]
    shrink = torch.full_like(p["log_scales"], 0.9).log()
    shrink[rows, axis] = math.log(0.6)
    opacity = 1 - torch.sqrt((1 - parents.opacities).clamp(min=1e-6))
    halves = []
    for sign in (1.0, -1.0):
        half = _copy(parents)
        half.means.add_(sign * offset)
        half.log_scales.add_(shrink)
        half.opacity_logits.copy_(torch.logit(opacity.clamp(1e-4, 1 - 1e-4)))
        halves.append(half)
    return halves


def _copy(gaussians: GaussianSet) -> GaussianSet:
    return gaussians.select(torch.arange(len(gaussians), device=gaussians.device))
