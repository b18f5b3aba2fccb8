"""Loss terms on the motion, beside the image terms: L_4DEdge and the smoothness of the planes (Eq. 9), and three priors.

One camera at one time constrains motion only weakly: it leaves depth, hidden parts and the times between frames undetermined. The priors
favour rest, rigid parts and steady motion there. All three are norms, not squared norms, so that a joint, or a part that starts to move,
costs no more than in proportion to its motion.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ...rasterizer import Camera, Gaussians
from ..model import Model
from ..motion.interface import Motion
from ..motion.times import Time
from ..settings import TrainingSettings
from ..views import CACHE_BYTES, Views
from .flow_loss import data_flow_loss, interval_loss

MeasuredFlow = Callable[[int], tuple[Tensor, Tensor] | None]
PRIOR_EVERY = 4  # steps between two evaluations of the priors and of plane smoothness; their weights are scaled up to compensate
PRIOR_SAMPLES = 1024
FLOW_SCALE = 0.5  # size at which flow is rendered
NEIGHBOURHOOD = 0.025  # of the viewing distance: distance between two places that should move alike


class FlowTarget(NamedTuple):
    """What the flow at one frame should be. flow [h, w, 2] px, from ``camera`` to ``next_camera`` at time ``later``; edges [h, w]: weight
    of each pixel."""

    camera: Camera
    next_camera: Camera
    later: Time
    flow: Tensor
    edges: Tensor


def displacement(moved: Gaussians, rest: Tensor, dynamic: Tensor) -> Tensor:
    """Mean displacement, world units, of those of ``rest`` [N, 3] that are ``dynamic`` [N]."""
    return (moved.means - rest).norm(dim=1).sum() / dynamic.sum().clamp(min=1)


def motion_priors(motion: Motion, rest: Tensor, noise: Tensor, t: Time, dt: float, unit: float, rigid: float, inertia: float) -> Tensor:
    """Priors towards rigid and steady motion at ``rest`` [n, 3], weighted by ``rigid`` and ``inertia``. Neighbours for the rigidity term
    are offset from ``rest`` along standard normal ``noise`` [n, 3]."""
    strain, course = motion.priors(rest, rest + NEIGHBOURHOOD * unit * noise, t, dt)
    return rigid * strain + inertia * course


class MotionTerms:
    """The motion terms of one training run, and how often each is evaluated.

    unit: the viewing distance, world units. rest: weight of the mean displacement. inertia: weight of how abruptly motion changes.
    interval: weight of L_interval. times: number of distinct times in the capture. measured_flow: see `Trainer`.
    """

    def __init__(
        self,
        views: Views,
        settings: TrainingSettings,
        unit: float,
        rest: float,
        inertia: float,
        interval: float,
        times: int,
        measured_flow: MeasuredFlow | None,
    ) -> None:
        self.views, self.settings, self.unit, self.measured_flow = views, settings, unit, measured_flow
        self.rest, self.inertia, self.interval = rest, inertia, interval
        self.times = times
        self.dt = 1.0 / max(times - 1, 1)
        self._has_target: dict[int, bool] = {}
        self._targets: dict[int, FlowTarget] = {}
        self._target_bytes = 0

    def __call__(self, model: Model, moved: Gaussians, i: int, scale: float, iteration: int, total: int) -> Tensor:
        """Weighted sum of the terms for training frame ``i``. ``moved``: its Gaussians at its time. ``scale``: image scale of the phase."""
        s, t = self.settings, self.views.moment(i)
        dynamic = model.gaussians.dynamic
        loss = torch.zeros((), device=model.device)
        if self.rest:
            loss = loss + self.rest / self.unit * displacement(moved, model.gaussians.means, dynamic)
        if iteration % PRIOR_EVERY == 0 and not model.motion.steady:
            if s.tv:
                loss = loss + PRIOR_EVERY * s.tv * model.motion.regulariser()
            if s.rigid or self.inertia:
                loss = loss + PRIOR_EVERY * self._priors(model, t, iteration)
        if self.flow_due(model, iteration, total) and model.moves():
            loss = loss + s.flow_every * self._flow(model, i, t, scale)
        return loss

    def flow_due(self, model: Model, iteration: int, total: int) -> bool:
        """Whether step ``iteration`` of ``total`` evaluates flow terms, which draw the whole image."""
        if iteration % self.settings.flow_every or iteration < 0.3 * total:
            return False
        return self.may_bend(model) or (self.measured_flow is not None and self.settings.data_flow > 0)

    def may_bend(self, model: Model) -> bool:
        """Whether L_interval has a weight and can differ from 0."""
        return self.interval > 0 and self.times >= 3 and not model.motion.steady

    def _priors(self, model: Model, t: Time, iteration: int) -> Tensor:
        s = self.settings
        if not model.motion.priors_at_places:
            none = model.gaussians.means.detach()[:0]
            return motion_priors(model.motion, none, none, t, self.dt, self.unit, s.rigid, self.inertia)
        generator = torch.Generator().manual_seed(s.seed * 1_000_003 + iteration)
        moving = model.gaussians.dynamic.nonzero()[:, 0]
        if not len(moving):
            return torch.zeros((), device=model.device)
        # Drawn on the CPU, so that every device gets the same numbers.
        chosen = torch.randint(len(moving), (PRIOR_SAMPLES,), generator=generator).to(moving.device)
        rest = model.gaussians.means.detach()[moving[chosen]]
        noise = torch.randn(rest.shape, generator=generator).to(rest.device)
        return motion_priors(model.motion, rest, noise, t, self.dt, self.unit, s.rigid, self.inertia)

    def _flow(self, model: Model, i: int, t: Time, scale: float) -> Tensor:
        s, views = self.settings, self.views
        total = torch.zeros((), device=model.device)
        if self.may_bend(model):
            start = t.clamp(max=1 - 2 * self.dt) if isinstance(t, Tensor) else min(t, 1 - 2 * self.dt)
            camera = views.rasterizer_camera(i, scale * FLOW_SCALE)
            total = total + self.interval * interval_loss(model, camera, start, self.dt, views.edges(i, scale * FLOW_SCALE))
        target = self.flow_target(i)
        if target is not None:
            total = total + s.data_flow * data_flow_loss(model, target.camera, t, *target[1:])
        return total

    def has_target(self, i: int) -> bool:
        """Whether training frame ``i`` has a `flow_target`."""
        if i not in self._has_target:
            self._has_target[i] = self.flow_target(i) is not None
        return self._has_target[i]

    def flow_target(self, i: int) -> FlowTarget | None:
        """What the flow at training frame ``i`` should be; None if that is unknown or has no weight. Kept on a GPU, as far as there is
        space for it: reading and resizing it takes longer than a step."""
        if i in self._targets:
            return self._targets[i]
        target = self._flow_target(i)
        if target is not None and torch.device(self.views.device).type != "cpu":
            self._target_bytes += target.flow.nbytes + target.edges.nbytes
            if self._target_bytes <= CACHE_BYTES:
                self._targets[i] = target
        return target

    def _flow_target(self, i: int) -> FlowTarget | None:
        measured = self.measured_flow(i) if self.measured_flow is not None and self.settings.data_flow else None
        if measured is None:
            return None
        views, later = self.views, int(self.views.next[i])
        flow, weight = (part.to(views.device) for part in measured)
        cameras = views.rasterizer_camera(i, FLOW_SCALE), views.rasterizer_camera(later, FLOW_SCALE)
        return FlowTarget(*cameras, views.moment(later), flow, weight * views.edges(i, FLOW_SCALE))
