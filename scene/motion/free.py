"""Primitives that each live around a time of their own: they drift and turn steadily, and fade before and after.

Primitives are independent of one another, so anything the images show can be modelled: objects that enter, leave, turn quickly or change.
Like spacetime Gaussians (Li et al. 2024), with the linear motion of free-time Gaussians (Wang et al. 2025).
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from ..rotation import compose, rotate
from .interface import Moved, Rest


class FreeMotion(nn.Module):
    """Implements `Motion` with the `Life` of each primitive; it has no parameters of its own.

    Args:
        times: number of distinct times in the capture; lives are measured in these frames.
    """

    worth_culling = True
    steady = True

    def __init__(self, times: int) -> None:
        super().__init__()
        self.times = int(times)
        self.config = {"kind": "free", "times": self.times}

    @classmethod
    def from_state(cls, state: dict[str, Tensor], config: dict) -> FreeMotion:
        """Inverse of `state_dict` and `config`."""
        return cls(config["times"])

    def light(self, t: float) -> None:
        """Colours do not change: primitives can appear and vanish instead."""

    def carry(self, rest: Rest, t: float) -> Moved:
        life = rest.life
        assert life is not None
        age = self.frame(t) - life.times
        turns = turned_by(life.spins * age[:, None])
        points = rest.points + life.velocities * age[:, None]
        m = len(rest.quats)
        if rest.centres is not None and len(points) > m:  # corners turn about the middle of their convex
            arms = rest.points[m:] - rest.centres[m:]
            points = torch.cat([points[:m], points[m:] + rotate(turns[m:], arms) - arms])
        presence = torch.exp(-0.5 * (age * torch.exp(-life.log_spans)).square())
        return Moved(points, compose(turns[:m], rest.quats), None, presence)

    def frame(self, t: float) -> float:
        """Fractional frame number at time ``t`` in [0, 1]."""
        return min(max(float(t), 0.0), 1.0) * (self.times - 1)

    def links(self, points: Tensor, hyper: Tensor) -> None:
        """None: each primitive carries itself."""

    def spread_over(self, points: np.ndarray) -> None:
        """None: there are no parts."""

    def priors(self, rest: Tensor, neighbours: Tensor, t: float, dt: float) -> tuple[Tensor, Tensor]:
        """Zero: motion is steady by construction, and primitives share nothing that could be kept rigid."""
        none = torch.zeros((), device=rest.device)
        return none, none

    def regulariser(self) -> Tensor:
        """There are no planes to smooth."""
        return torch.zeros(())


def turned_by(vectors: Tensor) -> Tensor:
    """Unit quaternions [N, 4] (w x y z) of rotation vectors [N, 3], radians; smooth at zero."""
    half = 0.5 * vectors
    angle = half.square().sum(1, keepdim=True).clamp(min=1e-16).sqrt()
    return torch.cat([torch.cos(angle), half * (torch.sin(angle) / angle)], 1)
