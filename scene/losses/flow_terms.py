"""L_4DEdge as terms of the loss: L_interval (Eq. 8), and rendered against measured flow. Both draw the whole image, at half resolution."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ...rasterizer import Camera
from ..model import Model
from ..motion.times import Time
from ..views import CACHE_BYTES, floats
from .flow_loss import data_flow_loss, interval_loss
from .term import Now, Rendered, Run, Term

FLOW_SCALE = 0.5  # size at which flow is rendered
BEGIN = 0.3  # fraction of the steps from which on they are evaluated


class FlowTarget(NamedTuple):
    """What the flow at one frame should be. flow [h, w, 2] px, from ``camera`` to ``next_camera`` at time ``later``; edges [h, w]: weight
    of each pixel."""

    camera: Camera
    next_camera: Camera
    later: Time
    flow: Tensor
    edges: Tensor


class _FlowTerm(Term):
    whole_image = True

    def __init__(self, run: Run) -> None:
        super().__init__(run)
        self.every = run.settings.flow_every

    def due(self, model: Model, now: Now) -> bool:
        return self.weight > 0 and now.move and now.number >= BEGIN * self.run.total


class Interval(_FlowTerm):
    """How unsteady the flow at edges is, see `interval_loss`; 0, and not evaluated, for what moves steadily by construction."""

    name = setting = "interval"

    def due(self, model: Model, now: Now) -> bool:
        return super().due(model, now) and self.run.times >= 3 and not model.motion.steady

    def inputs(self, model: Model, now: Now) -> tuple[Camera, Tensor] | None:
        scale = now.scale * FLOW_SCALE
        return (self.run.camera(now.frame, scale), self.run.views.stored(now.frame, scale, "edges")) if model.moves() else None

    def value(self, rendered: Rendered, inputs: tuple[Camera, Tensor]) -> Tensor:
        (camera, edges), t, dt = inputs, rendered.time, self.run.dt
        start = t.clamp(max=1 - 2 * dt) if isinstance(t, Tensor) else min(t, 1 - 2 * dt)
        return self.weight * interval_loss(rendered.model, camera, start, dt, floats(edges))


class MeasuredFlowTerm(_FlowTerm):
    """How far rendered flow is from measured flow, see `data_flow_loss`."""

    name, setting = "measured flow", "data_flow"

    def __init__(self, run: Run) -> None:
        super().__init__(run)
        self._targets: dict[int, FlowTarget] = {}
        self._bytes = 0

    def due(self, model: Model, now: Now) -> bool:
        return super().due(model, now) and self.run.measured.flow is not None

    def inputs(self, model: Model, now: Now) -> FlowTarget | None:
        return None if model.motion.static or not model.moves() else self.target(now.frame)

    def value(self, rendered: Rendered, inputs: FlowTarget) -> Tensor:
        return self.weight * data_flow_loss(rendered.model, inputs.camera, rendered.time, *inputs[1:])

    def target(self, i: int) -> FlowTarget | None:
        """What the flow at training frame ``i`` should be; None if that is unknown. Kept on a GPU, as far as there is space for it: reading
        and resizing it takes longer than a step."""
        if i in self._targets:
            return self._targets[i]
        views = self.run.views
        measured = None if self.run.measured.flow is None else self.run.measured.flow(i)
        if measured is None:
            return None
        flow, weight = (part.to(views.device) for part in measured)
        later = int(views.next[i])
        cameras = self.run.camera(i, FLOW_SCALE), self.run.camera(later, FLOW_SCALE)
        target = FlowTarget(*cameras, views.moment(later), flow, weight * views.edges(i, FLOW_SCALE))
        if torch.device(views.device).type != "cpu":
            self._bytes += flow.nbytes + target.edges.nbytes
            if self._bytes <= CACHE_BYTES:
                self._targets[i] = target
        return target
