"""The objective of a step, with its gradients, as a CUDA graph: one replay for the host in place of some hundred operations."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ....rasterizer.cuda.capacity import Watched, watching
from ...cuda.leaves import own_leaves
from ...losses.depth_spread import BEGIN, EVERY
from ...losses.motion_terms import PRIOR_EVERY
from ...model import Model
from ...motion.nodes import ControlNodes
from ...primitives import PrimitiveSet
from ..objective import RELINK_EVERY, Judged, Objective
from ..schedule import Phase
from .one_view import OneView

CHECK_EVERY = 64  # replays between two looks at whether the graph had room for all pairs


class _MadeFor(NamedTuple):
    """Objects are held, so that no other ones can take their memory, and compared by identity."""

    gaussians: PrimitiveSet
    convexes: PrimitiveSet
    field: Any
    dynamic: tuple[int, int]
    links: tuple[int | None, ...]

    def holds(self, now: _MadeFor) -> bool:
        return all(a is b for a, b in zip(self[:3], now[:3])) and self[3:] == now[3:]


@dataclass(eq=False)
class _Graph:
    """twin: the model that was captured, which keeps alive what the graph reads."""

    twin: Model
    flow: bool
    graph: torch.cuda.CUDAGraph
    view: OneView
    judged: Judged
    losses: Tensor
    frames: list[Watched]
    replays: int = 0


class ReplayedObjective:
    """`Objective` for a model on a GPU. The first step of a kind is computed as usual, the second one is captured, later ones are replays.

    Covers what control nodes are trained with; other steps are computed as usual. parameters: of the optimiser, by name. captures: how many
    graphs were made.
    """

    def __init__(self, objective: Objective, parameters: Callable[[], dict[str, Tensor]], say: Callable[[str], None]) -> None:
        self.objective, self._parameters, self._say = objective, parameters, say
        self._graphs: dict[Hashable, _Graph] = {}
        self._seen: set[Hashable] = set()  # kinds of steps that have been computed with the present model
        self._now: _MadeFor | None = None
        self._usable, self.captures = True, 0

    def __call__(self, model: Model, i: int, step: int, phase: Phase, sh_degree: int) -> Judged:
        if not self._usable or not self._covers(model, step, phase):
            return self.objective(model, i, step, phase, sh_degree)
        late = step > BEGIN * self.objective.total
        flow = phase.move and self.objective.motion_terms.flow_due(model, step, self.objective.total)
        kind = phase.scale, phase.move, sh_degree, late and step % EVERY == 0, step % PRIOR_EVERY == 0, flow
        made_for = self._made_for(model)
        if self._now is None or not self._now.holds(made_for):
            self._now = made_for
            self._graphs.clear()
            self._seen.clear()
        if kind not in self._seen:
            self._seen.add(kind)
            return self.objective(model, i, step, phase, sh_degree)
        if kind not in self._graphs:
            try:
                self._graphs[kind] = self._capture(model, i, step, phase, sh_degree, flow)
            except RuntimeError as cause:
                self._usable = False
                self._say(f"steps are not replayed as CUDA graphs: {str(cause).splitlines()[0]}")
                return self.objective(model, i, step, phase, sh_degree)
        found = self._graphs[kind]
        if found.replays % CHECK_EVERY == CHECK_EVERY - 1 and any(frame.overflowed() for frame in found.frames):
            del self._graphs[kind]  # pairs were left out; the next graph has more room
            return self.objective(model, i, step, phase, sh_degree)
        return self._replay(found, i)

    def _covers(self, model: Model, step: int, phase: Phase) -> bool:
        """Whether nothing but the frame changes between steps like this one."""
        o = self.objective
        known = isinstance(model.field, ControlNodes) and model.affine is None and o.measured_depth is None and not o.several
        measured = o.motion_terms.measured_flow is not None and o.settings.data_flow > 0
        return known and o.views.load_moving is None and not measured and step % RELINK_EVERY != 0

    def _made_for(self, model: Model) -> _MadeFor:
        """The memory that a step reads and writes, besides the frame's and that of the motion's parameters."""
        g, c = model.gaussians, model.convexes
        links = tuple(None if link is None else link.data_ptr() for link in (model.links(g), model.links(c)))
        return _MadeFor(g, c, model.field, (g.dynamic._version, c.dynamic._version), links)

    def _capture(self, model: Model, i: int, step: int, phase: Phase, sh_degree: int, flow: bool) -> _Graph:
        view = OneView(self.objective.views, phase.scale)
        view.show(i, flow)
        objective = self.objective.of(view)
        twin, parameters, graph = model.twin(), self._parameters(), torch.cuda.CUDAGraph()
        with own_leaves(model.field, model.affine):
            leaves = {name: p for name, p in twin.named_parameters().items() if name in parameters}
            with watching() as frames, torch.cuda.graph(graph, capture_error_mode="thread_local"):
                judged = objective(twin, i, step, phase, sh_degree)
                found = torch.autograd.grad(judged.loss, list(leaves.values()), allow_unused=True)
                losses = torch.stack([judged.loss.detach(), judged.image_loss])
        self.captures += 1
        gradients = [(parameters[name], gradient) for name, gradient in zip(leaves, found) if gradient is not None]
        judged = replace(judged, loss=losses[0], image_loss=losses[1], color=judged.color.detach(), gradients=gradients)
        return _Graph(twin, flow, graph, view, judged, losses, list(frames))

    def _replay(self, found: _Graph, i: int) -> Judged:
        found.view.show(i, found.flow)
        found.graph.replay()
        found.replays += 1
        loss, image_loss = found.losses.clone().unbind()  # they are read after the next replays
        return replace(found.judged, loss=loss, image_loss=image_loss)
