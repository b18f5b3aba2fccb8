"""Pieces that fade into one another, for formats that have no windows of time."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ....rasterizer import Gaussians
from ....scene.formats.pieces import LEAST_ALPHA, Pieces
from ..bake import Baked
from .pieces import Samples, intervals

SOFT = 0.6  # spread of a piece's opacity, in distances between pieces: less would flicker, more would blur
BEFORE = 2  # pieces before the first and after the last moment, which fade into the clip


def soft_pieces(baked: Baked, times: int, pixel: float) -> Pieces:
    """Like `pieces_of`, without windows. A Gaussian that one straight piece follows stays one. Another becomes evenly spaced pieces, half
    as long as the shortest that `pieces_of` makes of it, that overlap and together have its opacity nearly always."""
    samples = Samples.of(baked, times)
    last, (index, start, end) = samples.last, intervals(samples, pixel)
    shortest = torch.full((samples.means.shape[1],), 2 * last)
    shortest.scatter_reduce_(0, index, end - start, "amin")
    rows = [knots_of(torch.nonzero(shortest == length)[:, 0], int(length), last) for length in torch.unique(shortest[shortest <= last])]
    of, middle, apart = (torch.cat(parts) for parts in zip(*rows)) if rows else (torch.zeros(0, dtype=torch.int64), *torch.zeros(2, 0))
    once, step = apart.isinf(), torch.where(apart.isinf(), 1.0, apart)
    low = ((middle - step / 2).clamp(0, 1) * last).floor().long().clamp(max=last - 1)
    high = torch.maximum(((middle + step / 2).clamp(0, 1) * last).ceil().long(), low + 1)
    velocity = (samples.means[high, of] - samples.means[low, of]).double() / ((high - low).double() / last)[:, None]
    lives, spread = samples.middles[of], samples.spreads[of]
    own = torch.where(once, torch.inf, SOFT * step)
    # The product of the Gaussian's own life and of the piece's is a Gaussian of time again.
    weight, other = own.square().reciprocal(), spread.square().reciprocal()
    both = (weight + other).clamp(min=1e-12)
    when = torch.where(weight + other > 0, (weight * middle + other * lives) / both, middle)
    apart_now = torch.where(weight * other > 0, (middle - lives).square() * weight * other / both, 0.0)
    near = (middle.clamp(0, 1) * last).round().long()
    whole = samples.opacities[near, of].double()
    alone, smaller = shares(whole)
    opacity = torch.where(once, whole, alone) * torch.exp(-0.5 * apart_now)
    scales = samples.scales[near, of] * torch.where(once, 1.0, smaller).float()[:, None]
    means = samples.means[low, of].double() + velocity * (when - low.double() / last)[:, None]
    rest = baked.at(0.0).sh
    assert rest is not None
    sh = torch.cat([samples.colors[near, of][:, None], rest[of][:, 1:]], 1)
    look = Gaussians(means.float(), samples.quats[near, of], scales, opacity.float(), sh=sh)
    always = torch.full_like(when, torch.inf)
    found = Pieces(look, velocity, when, torch.where(weight + other > 0, both.rsqrt(), torch.inf), -always, always)
    return found.select((opacity >= LEAST_ALPHA).nonzero()[:, 0])


def knots_of(index: Tensor, length: int, last: int) -> tuple[Tensor, Tensor, Tensor]:
    """Gaussian, middle and distance [m] of the pieces of ``index``, whose shortest straight part has ``length`` samples; one piece with
    an infinite distance if that is the whole clip."""
    if length >= last:
        return index, torch.full((len(index),), 0.5).double(), torch.full((len(index),), torch.inf).double()
    apart = max(length // 2, 1) / last
    middles = (torch.arange(-BEFORE, round(1 / apart) + BEFORE) + 0.5).double() * apart
    return index.repeat_interleave(len(middles)), middles.repeat(len(index)), torch.full((len(index) * len(middles),), apart).double()


def shares(whole: Tensor) -> tuple[Tensor, Tensor]:
    """Opacity, and factor on standard deviations, [m] each, of every one of many pieces that overlap, which together look like a Gaussian
    of opacity ``whole`` [m]. What blends saturates, so the pieces are fainter than a share of it and a little smaller."""
    out, weight = np.linspace(0, 3.5, 30), np.linspace(0, 1, 30)  # standard deviations from the middle; pixels at such a distance
    seen = np.exp(-0.5 * ((np.linspace(0, 0.5, 5)[:, None] - np.arange(-4, 5)) / SOFT) ** 2)
    wanted, alone, smaller = np.linspace(0.02, 1, 25), np.linspace(0.005, 1, 60), np.linspace(0.86, 1, 15)
    profile = np.exp(-0.5 * (out / smaller[:, None]) ** 2)  # [15, 30]
    clear = 1 - alone[:, None, None, None, None] * seen[:, :, None, None] * profile  # opacity, phase, piece, size, distance
    together = 1 - clear.prod(2)
    rows = []
    for one in wanted:
        error = ((together - one * np.exp(-0.5 * out**2)) ** 2 * weight).sum(-1).mean(1)  # [60, 15]
        k, j = np.unravel_index(error.argmin(), error.shape)
        rows.append((alone[k], smaller[j]))
    opacity, size = np.array(rows).T
    at = whole.numpy()
    return torch.tensor(np.interp(at, [0, *wanted], [0, *opacity])), torch.tensor(np.interp(at, wanted, size))
