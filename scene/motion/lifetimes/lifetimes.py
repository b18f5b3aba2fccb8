"""Primitives that each live around a time of their own: they drift and turn steadily, and fade before and after.

Primitives are independent of one another, so anything the images show can be modelled: objects that enter, leave, turn quickly or change.
Like spacetime Gaussians (Li et al. 2024), with the linear motion of free-time Gaussians (Wang et al. 2025).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor

from ....rasterizer import Camera, Convexes, Gaussians
from ...primitives import GaussianSet, PrimitiveSet
from ...settings import TrainingSettings
from ...views import Views
from ..in_view import in_view
from ..interface import Motion, Moved, Scene, drawn
from ..rates import Rate, exponential
from ..recipe import Recipe
from ..start import MovingSeeds, Start
from ..times import Time
from .at_frame import at_frame, presence
from .halves import halves_in_time
from .lifetime import ATTRIBUTES, lifetime, set_lifetime

PACE, MOST_PACE = 0.35, 4.0  # rates grow with this power of the share of the times at which a primitive is present, at most so much
OVERLAP = 0.6  # standard deviation of the lifetime of a Gaussian, relative to the frames between two times with seeds,
LEAST, LEAST_ALONE = 1.0, 1.6  # frames; but at least so much, for several cameras and for one, which sees each time only from one side


class Lifetimes(Motion):
    """A motion by the `Lifetime` that each primitive carries; it has no parameters of its own.

    Args:
        times: number of distinct times in the capture; lifetimes are measured in these frames.
    """

    kind = "lifetimes"
    attributes = ATTRIBUTES
    recipe = Recipe(opacity=0.01, rest=0.0, freeze_at=2.0, opens=False)
    steady = True
    from_rest = False
    splits_in_time = True
    played_as = "lives"

    def __init__(self, times: int) -> None:
        super().__init__()
        self.times = int(times)

    @property
    def config(self) -> dict[str, Any]:
        return {"kind": self.kind, "times": self.times}

    @classmethod
    def from_state(cls, state: dict[str, Tensor], config: dict[str, Any]) -> Self:
        return cls(config["times"])

    @classmethod
    def start(cls, start: Start, views: Views, settings: TrainingSettings) -> tuple[Self, GaussianSet]:
        motion, gaussians = cls(len(np.unique(views.time))), start.gaussians()
        set_lifetime(gaussians, 0.5 * (motion.times - 1), motion.times)
        if start.moving is not None:
            least = LEAST_ALONE if len(np.unique(views.camera)) == 1 else LEAST
            gaussians = GaussianSet.joined([gaussians, *motion.around(start.moving, start.sh_degree, start.max_scale, least)])
        return motion, gaussians

    def around(self, seeds: MovingSeeds, sh_degree: int, max_scale: float, least: float = LEAST) -> list[GaussianSet]:
        """Gaussians on ``seeds``, one set per time, whose lifetimes overlap with those of the times before and after; their standard
        deviations are at least ``least`` frames."""
        times = np.unique(seeds.time)
        apart = (self.times - 1) * float(times[-1] - times[0]) / max(len(times) - 1, 1)
        sets = []
        for t in times:
            row = seeds.time == t
            one = GaussianSet.from_points(seeds.points[row], seeds.colors[row], sh_degree, max_scale=max_scale)
            set_lifetime(one, self.frame(t), max(OVERLAP * apart, least), torch.from_numpy(seeds.velocities[row]).float())
            sets.append(one)
        return sets

    def primitives_at(self, scene: Scene, t: Time, camera: Camera | None, sh_degree: int) -> tuple[Gaussians, Convexes]:
        g, c = drawn(scene, sh_degree)
        means, quats, opacities = self.alive(scene.gaussians, t, g.opacities)
        assert quats is not None
        gaussians = Gaussians(means, quats, g.scales, opacities, sh=g.sh)
        if len(scene.convexes):
            points, _, opacities = self.alive(scene.convexes, t, c.opacities)
            c = Convexes(points, c.tau, c.kappa, opacities, sh=c.sh)
        return gaussians, c

    def alive(self, primitives: PrimitiveSet, t: Time, whole: Tensor | None = None) -> tuple[Tensor, Tensor | None, Tensor]:
        """At time ``t`` in [0, 1], of all N primitives: their points, as means [N, 3] or corners [N, K, 3]; the quaternions [N, 4] of
        Gaussians, None for convexes; their opacities [N]. Those that are not dynamic are at rest. ``whole`` [N]: the opacities that they
        have at most, if they are known already."""
        single = isinstance(primitives, GaussianSet)
        points, quats = (primitives.means[:, None], primitives.quats) if single else (primitives.points, None)
        whole = primitives.opacities if whole is None else whole
        moved, turned, shown = at_frame(points, quats, whole, lifetime(primitives), primitives.dynamic, self.frame(t))
        return moved[:, 0] if single else moved, turned, shown

    def opacities(self, gaussians: GaussianSet, t: Time) -> Tensor:
        present = presence(lifetime(gaussians), self.frame(t))
        return gaussians.opacities * torch.where(gaussians.dynamic, present, 1.0)

    def carried(self, scene: Scene, index: Tensor, t: float) -> Moved:
        chosen = scene.gaussians.select(index)
        chosen.dynamic.fill_(True)
        means, quats, _ = self.alive(chosen, t)
        assert quats is not None
        return Moved(means, quats, None)

    def in_view(self, gaussians: GaussianSet, camera: Camera, t: Time | None, tiles: Tensor | None, fuller: float) -> Tensor | None:
        return in_view(gaussians, camera, None if t is None else float(self.frame(float(t))), tiles, fuller)

    def frame(self, t: Time) -> Time:
        """Fractional frame number at time ``t`` in [0, 1]."""
        return (t.clamp(0, 1) if isinstance(t, Tensor) else min(max(t, 0.0), 1.0)) * (self.times - 1)

    def attribute_rates(self, settings: TrainingSettings, unit: float, scale: float) -> dict[str, Rate]:
        drift = 0.2 * settings.lr_means * unit
        return {
            "times": exponential(2e-2 * scale, 2e-3),
            "log_spans": exponential(1e-2 * scale, 1e-3),
            "velocities": exponential(drift * scale, drift / 50),
            "spins": exponential(1e-3 * scale, 1e-4),
        }

    def pace(self, parameters: Mapping[str, Tensor]) -> Tensor | None:
        """Larger for short lifetimes: only steps near them change what is present so briefly."""
        log_spans = parameters.get("log_spans")
        if log_spans is None:
            return None
        log_share = log_spans.detach() + math.log(math.sqrt(2 * math.pi) / self.times)
        return torch.exp(-PACE * log_share).clamp(1.0, MOST_PACE)

    def halves_in_time(self, parents: GaussianSet) -> list[GaussianSet]:
        return halves_in_time(parents, self.times)
