"""Gaussians on straight paths, each present for a part of the time: what open 4D formats hold."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ...rasterizer import Gaussians
from .ply import LEAST_ALPHA

ALWAYS = 1e3  # a spread, in clips, that is no fade any more


@dataclass
class Pieces:
    """n Gaussians. Time is that of the capture, in [0, 1].

    gaussians: with sh, as they are at ``middles`` [n], and with the opacity that they have there. velocities [n, 3]: world units per unit
    of time. spreads [n]: standard deviations of opacity over time, inf for none. A piece is present in [``low``, ``high``), [n] each.
    """

    gaussians: Gaussians
    velocities: Tensor
    middles: Tensor
    spreads: Tensor
    low: Tensor
    high: Tensor

    def __len__(self) -> int:
        return len(self.middles)

    def select(self, index: Tensor) -> Pieces:
        g = self.gaussians
        assert g.sh is not None
        some = Gaussians(g.means[index], g.quats[index], g.scales[index], g.opacities[index], sh=g.sh[index])
        return Pieces(some, *(own[index] for own in (self.velocities, self.middles, self.spreads, self.low, self.high)))

    def at(self, t: float) -> Gaussians:
        """Those that are present at ``t`` in [0, 1] and opaque enough to be drawn."""
        age = t - self.middles
        opacities = self.gaussians.opacities * torch.exp(-0.5 * (age / self.spreads).square())
        there = ((self.low <= t) & (t < self.high) & (opacities >= LEAST_ALPHA)).nonzero()[:, 0]
        found = self.select(there).gaussians
        means = found.means + self.velocities[there] * age[there, None]
        return Gaussians(means, found.quats, found.scales, opacities[there], sh=found.sh)
