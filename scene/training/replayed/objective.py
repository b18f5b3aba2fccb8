"""The objective of a step, with its gradients, as a CUDA graph: replaying it takes the host a tenth of the time."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ....rasterizer.cuda.capacity import Watched, watching
from ...cuda.leaves import own_leaves
from ...losses.depth_spread import BEGIN, EVERY
from ...losses.motion_terms import PRIOR_EVERY, flow_due
from ...model import Model
from ...motion.nodes import ControlNodes
from ..objective import RELINK_EVERY, Judged, Objective
from ..schedule import Phase
from .one_view import OneView

CHECK_EVERY = 16  # replays between two looks at whether the graph had room for all pairs


@dataclass(eq=False)
class _Graph:
    """made_for: what it depends on besides its key; it is only valid as long as that is the same."""

    made_for: Hashable
    graph: torch.cuda.CUDAGraph
    view: OneView
    judged: Judged
    gradients: list[tuple[Tensor, Tensor]]
    frames: list[Watched]
    replays: int = 0


class ReplayedObjective:
    """`Objective` for a model on a GPU. The first step of a kind is computed as usual, the second one is captured, later ones are replays.

    Covers what control nodes are trained with; other steps are computed as usual. parameters: of the optimiser, by name.
    """

    def __init__(self, objective: Objective, parameters: Callable[[], dict[str, Tensor]], say: Callable[[str], None]) -> None:
        self.objective, self._parameters, self._say = objective, parameters, say
        self._graphs: dict[Hashable, _Graph] = {}
        self._seen: set[tuple[Hashable, Hashable]] = set()
        self._usable = True

    def __call__(self, model: Model, i: int, step: int, phase: Phase, sh_degree: int) -> Judged:
        if not self._usable or not self._covers(model, step, phase):
            return self.objective(model, i, step, phase, sh_degree)
        late = step > BEGIN * self.objective.total
        kind = phase.scale, phase.move, sh_degree, late and step % EVERY == 0, step % PRIOR_EVERY == 0
        made_for = self._identity(model)
        found = self._graphs.get(kind)
        if found is None or found.made_for != made_for:
            self._graphs.pop(kind, None)
            if (kind, made_for) not in self._seen:
                self._seen = {(k, m) for k, m in self._seen if m == made_for} | {(kind, made_for)}
                return self.objective(model, i, step, phase, sh_degree)
            try:
                found = self._graphs[kind] = self._capture(model, i, step, phase, sh_degree, made_for)
            except RuntimeError as cause:
                self._usable = False
                self._say(f"steps are not replayed as CUDA graphs: {str(cause).splitlines()[0]}")
                return self.objective(model, i, step, phase, sh_degree)
        return self._replay(found, i)

    def _covers(self, model: Model, step: int, phase: Phase) -> bool:
        """Whether nothing but the frame changes between steps like this one."""
        o = self.objective
        known = isinstance(model.field, ControlNodes) and model.affine is None and o.measured_depth is None and not o.several
        flow = phase.move and flow_due(o.settings, step, o.total)
        return known and o.views.load_moving is None and not flow and step % RELINK_EVERY != 0

    def _identity(self, model: Model) -> Hashable:
        """The memory that a step reads and writes, besides the frame's."""
        sets = model.gaussians, model.convexes
        links = [None if link is None else link.data_ptr() for link in map(model.links, sets)]
        dynamic = [(s.dynamic.data_ptr(), s.dynamic._version) for s in sets]
        addresses = [(p.data_ptr(), tuple(p.shape)) for p in self._parameters().values()]
        return id(model.field), *links, *dynamic, *addresses

    def _capture(self, model: Model, i: int, step: int, phase: Phase, sh_degree: int, made_for: Hashable) -> _Graph:
        view = OneView(self.objective.views, phase.scale)
        view.show(i)
        objective = self.objective.of(view)
        twin, parameters, graph = model.twin(), self._parameters(), torch.cuda.CUDAGraph()
        with own_leaves(model.field, model.affine):
            leaves = {name: p for name, p in twin.named_parameters().items() if name in parameters}
            with watching() as frames, torch.cuda.graph(graph, capture_error_mode="thread_local"):
                judged = objective(twin, i, step, phase, sh_degree)
                found = torch.autograd.grad(judged.loss, list(leaves.values()), allow_unused=True)
        gradients = [(parameters[name], gradient) for name, gradient in zip(leaves, found) if gradient is not None]
        judged = replace(judged, loss=judged.loss.detach(), color=judged.color.detach(), gradients=gradients)
        return _Graph(made_for, graph, view, judged, gradients, list(frames))

    def _replay(self, found: _Graph, i: int) -> Judged:
        found.view.show(i)
        found.graph.replay()
        found.replays += 1
        if found.replays % CHECK_EVERY == 1 and any(frame.overflowed() for frame in found.frames):
            found.made_for = None  # pairs were left out: capture again, with more room
        # Both are read after the next replays.
        return replace(found.judged, loss=found.judged.loss.clone(), image_loss=found.judged.image_loss.clone())
