"""Priors on the motion: towards rest, smooth planes (Eq. 9), rigid parts, and steady motion.

One camera at one time constrains motion only weakly: it leaves depth, hidden parts and the times between frames undetermined. The priors
on what moves are norms, not squared norms, so that a joint, or a part that starts to move, costs no more than in proportion to its motion.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..model import Model
from .term import Now, Rendered, Run, Term

PRIOR_EVERY = 4  # steps between two evaluations
PRIOR_SAMPLES = 1024
NEIGHBOURHOOD = 0.025  # of the viewing distance: distance between two places that should move alike


class Rest(Term):
    """Mean displacement of what is dynamic, in viewing distances."""

    name = setting = "rest"

    def due(self, model: Model, now: Now) -> bool:
        return self.weight > 0 and now.move and not model.motion.static

    def value(self, rendered: Rendered, inputs: Any) -> Tensor:
        rest, dynamic = rendered.model.gaussians.means, rendered.model.gaussians.dynamic
        displacement = (rendered.gaussians.means - rest).norm(dim=1).sum() / dynamic.sum().clamp(min=1)
        return self.weight / self.run.unit * displacement


class PlaneSmoothness(Term):
    """The term of lambda_3 in Eq. 9."""

    name, setting, every = "planes", "tv", PRIOR_EVERY

    def due(self, model: Model, now: Now) -> bool:
        return self.weight > 0 and now.move and not model.motion.steady

    def value(self, rendered: Rendered, inputs: Any) -> Tensor:
        return self.weight * rendered.model.motion.regulariser()


class RigidAndSteady(Term):
    """`Motion.priors`: parts move rigidly, and all motion steadily. The motion is judged where some Gaussians are and beside them; these
    places are drawn on the CPU, so that every device gets the same."""

    name, every = "priors", PRIOR_EVERY

    def __init__(self, run: Run) -> None:
        super().__init__(run)
        self.rigid, self.inertia = run.weight("rigid"), run.weight("inertia")

    def due(self, model: Model, now: Now) -> bool:
        return self.rigid + self.inertia > 0 and now.move and not model.motion.steady

    def inputs(self, model: Model, now: Now) -> tuple[Tensor | None, Tensor | None] | None:
        """Which Gaussians [n] int64, and standard normal numbers [n, 3] for the places beside them."""
        if not model.motion.priors_at_places:
            return None, None
        generator, moving = torch.Generator().manual_seed(self.run.settings.seed * 1_000_003 + now.number), model.moving(model.gaussians)
        if not len(moving):
            return None
        chosen = torch.randint(len(moving), (PRIOR_SAMPLES,), generator=generator).to(moving.device)
        return moving[chosen], torch.randn(PRIOR_SAMPLES, 3, generator=generator).to(moving.device)

    def value(self, rendered: Rendered, inputs: tuple[Tensor | None, Tensor | None]) -> Tensor:
        (chosen, noise), motion, means = inputs, rendered.model.motion, rendered.model.gaussians.means.detach()
        rest = means[:0] if chosen is None else means[chosen]
        beside = rest if noise is None else rest + NEIGHBOURHOOD * self.run.unit * noise
        strain, course = motion.priors(rest, beside, rendered.time, self.run.dt)
        return self.rigid * strain + self.inertia * course
