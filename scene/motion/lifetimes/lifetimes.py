"""Primitives that each live around a time of their own: they drift and turn steadily, and fade before and after.

Primitives are independent of one another, so anything the images show can be modelled: objects that enter, leave, turn quickly or change.
Like spacetime Gaussians (Li et al. 2024), with the linear motion of free-time Gaussians (Wang et al. 2025).
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor, nn

from ...primitives import GaussianSet, PrimitiveSet
from ..interface import Time
from .at_frame import live, presence

PACE, MOST_PACE = 0.35, 4.0  # rates grow with this power of the share of the times at which a primitive is present, at most so much


class FreeMotion(nn.Module):
    """A `Motion` by the `Life` of each primitive (`Model.at` calls `alive` in place of `carry`); it has no parameters of its own.

    Args:
        times: number of distinct times in the capture; lives are measured in these frames.
    """

    worth_culling = False
    steady = True
    priors_at_places = False

    def __init__(self, times: int) -> None:
        super().__init__()
        self.times = int(times)
        self.config = {"kind": "free", "times": self.times}

    @classmethod
    def from_state(cls, state: dict[str, Tensor], config: dict) -> FreeMotion:
        """Inverse of `state_dict` and `config`."""
        return cls(config["times"])

    def light(self, t: Time) -> None:
        """Colours do not change: primitives can appear and vanish instead."""

    def alive(self, primitives: PrimitiveSet, t: Time, whole: Tensor | None = None) -> tuple[Tensor, Tensor | None, Tensor]:
        """At time ``t`` in [0, 1], of all N primitives: their points, as means [N, 3] or corners [N, K, 3]; the quaternions [N, 4] of
        Gaussians, None for convexes; their opacities [N]. Those that are not dynamic are at rest. ``whole`` [N]: the opacities that they
        have at most, if they are known already."""
        single = isinstance(primitives, GaussianSet)
        points, quats = (primitives.means[:, None], primitives.quats) if single else (primitives.points, None)
        whole = primitives.opacities if whole is None else whole
        moved, turned, shown = live(points, quats, whole, primitives.life, primitives.dynamic, self.frame(t))
        return moved[:, 0] if single else moved, turned, shown

    def opacities(self, primitives: PrimitiveSet, t: Time) -> Tensor:
        """The opacities [N] of `alive` alone."""
        present = presence(primitives.life, self.frame(t))
        return primitives.opacities * torch.where(primitives.dynamic, present, 1.0)

    def frame(self, t: Time) -> Time:
        """Fractional frame number at time ``t`` in [0, 1]."""
        return (t.clamp(0, 1) if isinstance(t, Tensor) else min(max(t, 0.0), 1.0)) * (self.times - 1)

    def pace(self, log_spans: Tensor) -> Tensor:
        """[m], larger for short lives (see `Life`): only steps near them change what is present so briefly."""
        log_share = log_spans.detach() + math.log(math.sqrt(2 * math.pi) / self.times)
        return torch.exp(-PACE * log_share).clamp(1.0, MOST_PACE)

    def links(self, points: Tensor, hyper: Tensor) -> None:
        """None: each primitive carries itself."""

    def spread_over(self, points: np.ndarray) -> None:
        """None: there are no parts."""

    def priors(self, rest: Tensor, neighbours: Tensor, t: Time, dt: float) -> tuple[Tensor, Tensor]:
        """Zero: motion is steady by construction, and primitives share nothing that could be kept rigid."""
        none = torch.zeros((), device=rest.device)
        return none, none

    def regulariser(self) -> Tensor:
        """There are no planes to smooth."""
        return torch.zeros(())
