"""Gaussians that are split: which, and into what. In space by default; in time where the same place must look different at other times."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ...motion.lifetimes.at_frame import turned_by
from ...primitives import GaussianSet
from ...rotation import compose, quats_to_matrices

# Who stays throughout, and is split in time, counts as living with a standard deviation of so many durations of the capture.
WHOLE = 0.43
APART, SHORTER = 0.58, 0.7  # the halves: their middles lie so many standard deviations to either side; their own, in those of the parent


def choose_to_split(gaussians: GaussianSet, error: Tensor, count: int) -> Tensor:
    """Indices of the ``count`` Gaussians with the largest attributed ``error`` [N]; those that no probed pixel saw are never chosen."""
    count = min(count, int((error > 0).sum()))
    return error.topk(count).indices.sort().values if count > 0 else torch.zeros(0, dtype=torch.long, device=error.device)


def split(gaussians: GaussianSet, in_space: Tensor, in_time: Tensor | None = None, times: int = 1) -> tuple[GaussianSet, Tensor]:
    """Split each Gaussian of the indices ``in_space`` into two along its longest axis, and each of ``in_time`` into two lives; the others
    stay. times: number of distinct times of the capture. Returns the new set and, for each of its rows, the old row whose optimiser state
    it keeps (-1 for children)."""
    halves = along_longest_axis(gaussians.select(in_space))
    kept = torch.ones(len(gaussians), dtype=torch.bool, device=gaussians.device)
    kept[in_space] = False
    if in_time is not None and len(in_time):
        halves += into_lives(gaussians.select(in_time), times)
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


@torch.no_grad()
def into_lives(parents: GaussianSet, times: int) -> list[GaussianSet]:
    """The halves of ``parents``: an earlier and a later life on the same course. Together they are present nearly as their parent was. A
    parent that stays throughout the ``times`` frames has halves that live around the first and the last quarter of the capture."""
    longest = WHOLE * times
    span = torch.where(parents.dynamic, parents.log_spans.exp(), torch.inf)
    middle = torch.where(span < longest, parents.times, (times - 1) / 2)
    span = span.clamp(max=longest)
    halves = []
    for sign in (-1.0, 1.0):
        half = _copy(parents)
        half.times.copy_(middle + sign * APART * span)
        half.log_spans.copy_(torch.log(SHORTER * span))
        later = torch.where(parents.dynamic, half.times - parents.times, 0.0)[:, None]
        half.means.add_(parents.velocities * later)
        half.quats.copy_(compose(turned_by(parents.spins * later), parents.quats))
        half.dynamic[:] = True
        halves.append(half)
    return halves


def _copy(gaussians: GaussianSet) -> GaussianSet:
    return gaussians.select(torch.arange(len(gaussians), device=gaussians.device))
