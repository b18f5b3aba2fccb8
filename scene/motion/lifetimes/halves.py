"""Gaussians that are split in time, where the same place must look different at other times."""

from __future__ import annotations

import torch

from ...primitives import GaussianSet
from ...rotation import compose
from .at_frame import turned_by

# Who stays throughout counts as living with a standard deviation of so many durations of the capture.
WHOLE = 0.43
APART, SHORTER = 0.58, 0.7  # the halves: their middles lie so many standard deviations to either side; their own, in those of the parent


@torch.no_grad()
def halves_in_time(parents: GaussianSet, times: int) -> list[GaussianSet]:
    """The halves of ``parents``: an earlier and a later lifetime on the same course. Together they are present nearly as their parent was.
    A parent that stays throughout the ``times`` frames has halves that live around the first and the last quarter of the capture."""
    longest = WHOLE * times
    span = torch.where(parents.dynamic, parents.log_spans.exp(), torch.inf)
    middle = torch.where(span < longest, parents.times, (times - 1) / 2)
    span = span.clamp(max=longest)
    halves = []
    for sign in (-1.0, 1.0):
        half = parents.select(torch.arange(len(parents), device=parents.device))
        half.times.copy_(middle + sign * APART * span)
        half.log_spans.copy_(torch.log(SHORTER * span))
        later = torch.where(parents.dynamic, half.times - parents.times, 0.0)[:, None]
        half.means.add_(parents.velocities * later)
        half.quats.copy_(compose(turned_by(parents.spins * later), parents.quats))
        half.dynamic[:] = True
        halves.append(half)
    return halves
