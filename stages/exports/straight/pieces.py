"""The motion of a model in pieces that are straight: a Gaussian becomes as few as follow it closely, one after the other."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ....rasterizer import Gaussians
from ....scene.formats.axes import Turn
from ....scene.formats.pieces import LEAST_ALPHA, Pieces
from ....scene.formats.ply import seen
from ....scene.rotation import quats_to_matrices
from ..bake import Baked
from .lives import fades, moves

PATH, SHAPE = 0.25, 0.5  # px of the capture by which a piece may be off its Gaussian: its mean, its extent
OPACITY, COLOR = 0.015, 0.04  # likewise; the second in SH coefficients
MOST_LEVELS = 8  # a clip is halved so often at most
EXTRA = 2  # halvings beyond the intervals between the times of the capture
MOST_BYTES = 3 << 29  # of samples in memory
LOOKED_AT = 9  # moments of a piece at which it is compared with its Gaussian


@dataclass
class Samples:
    """Gaussians at evenly spaced times from 0 to 1, [S, n, c] each. opacities: where ``spreads`` are finite, the
    most."""

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    colors: Tensor
    middles: Tensor
    spreads: Tensor

    @classmethod
    def of(cls, baked: Baked, times: int) -> Samples:
        """Two pieces at least for each interval between two times of the capture can be told apart, if memory allows."""
        count, (levels, _) = len(baked.model.gaussians) + len(baked.model.convexes), halvings(baked, times)
        found = [baked.at(k / (2 << levels)) for k in range((2 << levels) + 1)]
        names = "means", "quats", "scales", "opacities"
        means, quats, scales, opacities = (torch.stack([getattr(one, name) for one in found]) for name in names)
        colors = torch.stack([one.sh[:, 0] for one in found if one.sh is not None])
        lives = fades(baked)
        if lives is None:
            always = torch.full((count,), torch.inf).double()
            return cls(means, quats, scales, opacities, colors, torch.zeros(count).double(), always)
        middles, spreads, whole = lives
        return cls(means, quats, scales, whole.float().expand(len(found), -1), colors, middles, spreads)

    @property
    def last(self) -> int:
        return len(self.means) - 1


def halvings(baked: Baked, times: int) -> tuple[int, int]:
    """How often the clip can be halved for a Gaussian as far as memory allows, and how often it would be without that limit."""
    count = len(baked.model.gaussians) + len(baked.model.convexes)
    wanted = levels = min(math.ceil(math.log2(max(times - 1, 1))) + EXTRA, MOST_LEVELS) if moves(baked) else 0
    while levels > 1 and (2 << levels) * count * 56 > MOST_BYTES:
        levels -= 1
    return levels, wanted


def pieces_of(baked: Baked, times: int, pixel: float) -> Pieces:
    """``baked`` as `Pieces` that follow it within `PATH` and the others. times: of the capture. pixel: its width where the scene is, world
    units. What is too faint to be drawn is left out."""
    samples = Samples.of(baked, times)
    index, start, end = intervals(samples, pixel)
    last, middle = samples.last, (start + end) // 2
    low, high = start.double() / last, end.double() / last
    velocity = (samples.means[end, index] - samples.means[start, index]).double() / (high - low)[:, None]
    spreads = samples.spreads[index]
    when = torch.where(spreads.isinf(), (low + high) / 2, samples.middles[index])
    means = samples.means[start, index].double() + velocity * (when - low)[:, None]
    whole = baked.at(0.0).sh
    assert whole is not None
    sh = torch.cat([samples.colors[middle, index][:, None], whole[index][:, 1:]], 1)
    look = Gaussians(means.float(), samples.quats[middle, index], samples.scales[middle, index], samples.opacities[middle, index], sh=sh)
    infinity = torch.full_like(low, torch.inf)
    return Pieces(look, velocity, when, spreads, torch.where(start == 0, -infinity, low), torch.where(end == last, infinity, high))


def still_pieces(baked: Baked, t: float) -> Pieces:
    """``baked`` at ``t`` alone, present throughout."""
    shown = seen(baked.at(t))
    always = torch.full((len(shown.means),), torch.inf).double()
    none = torch.zeros(len(always)).double()
    return Pieces(shown, none[:, None].expand(-1, 3), none, always, -always, always)


def intervals(samples: Samples, pixel: float) -> tuple[Tensor, Tensor, Tensor]:
    """Gaussian, first and last sample [m] of each piece. The clip is halved for a Gaussian until each part of it is straight enough."""
    found = []
    waiting = [(0, samples.last, torch.arange(samples.means.shape[1]))]
    while waiting:
        start, end, index = waiting.pop()
        index = index[brightest(samples, start, end, index) >= LEAST_ALPHA]
        if not len(index):
            continue
        good = torch.ones(len(index), dtype=torch.bool) if end - start <= 2 else straight(samples, start, end, index, pixel)
        kept, half = index[good], (start + end) // 2
        found.append((kept, torch.full_like(kept, start), torch.full_like(kept, end)))
        if not good.all():
            waiting += [(start, half, index[~good]), (half, end, index[~good])]
    empty = torch.zeros(0, dtype=torch.int64)
    of, first, last = (torch.cat(parts) for parts in zip((empty, empty, empty), *found))
    order = torch.argsort(first * samples.means.shape[1] + of)
    return of[order], first[order], last[order]


def looked_at(start: int, end: int) -> list[int]:
    return sorted({start + round(k * (end - start) / (LOOKED_AT - 1)) for k in range(LOOKED_AT)})


def brightest(samples: Samples, start: int, end: int, index: Tensor) -> Tensor:
    """The largest opacity of each of ``index`` in this interval."""
    opacity = torch.stack([samples.opacities[k, index] for k in looked_at(start, end)]).amax(0)
    middle, spread = samples.middles[index], samples.spreads[index]
    nearest = middle.clamp(start / samples.last, end / samples.last)
    return opacity * torch.exp(-0.5 * ((nearest - middle) / spread).square()).float()


def straight(samples: Samples, start: int, end: int, index: Tensor, pixel: float) -> Tensor:
    """Whether one piece follows each of ``index`` closely enough from one sample to the other: [m] bool."""
    middle = (start + end) // 2
    first, way = samples.means[start, index], samples.means[end, index] - samples.means[start, index]
    usual, size = spread_of(samples, middle, index), samples.scales[middle, index].amax(1).clamp(min=1e-12)
    good = torch.ones(len(index), dtype=torch.bool)
    for k in looked_at(start, end):
        off = (samples.means[k, index] - first - way * ((k - start) / (end - start))).norm(dim=1)
        turned = (spread_of(samples, k, index) - usual).flatten(1).norm(dim=1) / size
        good &= (off <= PATH * pixel) & (turned <= SHAPE * pixel)
        good &= (samples.opacities[k, index] - samples.opacities[middle, index]).abs() <= OPACITY
        good &= (samples.colors[k, index] - samples.colors[middle, index]).abs().amax(1) <= COLOR
    return good


def spread_of(samples: Samples, k: int, index: Tensor) -> Tensor:
    """[m, 3, 3] covariances at sample ``k``."""
    wide = quats_to_matrices(samples.quats[k, index]) * samples.scales[k, index][:, None]
    return wide @ wide.transpose(1, 2)


def turned_pieces(pieces: Pieces, turn: Turn) -> Pieces:
    """``pieces`` in the axes of a file."""
    matrix = torch.as_tensor(turn.matrix).to(pieces.velocities)
    return replace(pieces, gaussians=turn(pieces.gaussians), velocities=pieces.velocities @ matrix.T)
