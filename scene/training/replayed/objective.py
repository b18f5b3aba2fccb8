"""The objective of a step, with its gradients, as a CUDA graph: one replay for the host in place of some hundred operations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ....rasterizer.rasterize import FAR_CAMERA
from ...colour import row_of
from ...cuda.graph import Graph, Recorded, Results
from ...cuda.leaves import own_leaves
from ...losses.depth_spread import BEGIN, EVERY
from ...losses.motion_terms import PRIOR_EVERY
from ...model import Model
from ...views import Views
from ..drawn_tiles import Drawn
from ..objective import Judged, Objective
from ..schedule import Phase
from .of_one_view import OfOneView
from .one_view import Kind, OneView
from .rooms import Rooms

CHECK_EVERY = 64  # replays between two looks at whether the graph had room for all pairs
IMAGES = 6  # results in front of the gradients: losses, colour, target, weight, gain, offset

Record = Callable[[Callable[[], Results], torch.device, Any], Recorded]


@dataclass(eq=False)
class _Step:
    """A captured kind of step. names: of the parameters whose gradients are the last results. cut: these gradients without the rows that
    hold nothing, and their parameters; None after rows have changed."""

    graph: Recorded
    view: OneView
    names: list[str]
    replays: int = 0
    cut: list[tuple[Tensor, Tensor]] | None = None


def replayable(views: Views) -> bool:
    """Whether no camera is so far from the origin that scenes are moved there before they are drawn."""
    return bool(np.linalg.norm(views.centres(), axis=1).max() < FAR_CAMERA)


class ReplayedObjective:
    """`Objective` for a model on a GPU. The first step of a kind is computed as usual, the second one is captured, later ones are replays.

    A graph computes in memory with room for more primitives than there are (`Room`), to which the model's parameters are moved, so that it
    can go on when density control adds some and removes others. Computed as usual are steps with a six-plane field, which needs the time on
    the CPU, and those of cameras so far from the origin that scenes are moved there.

    parameters: of the optimiser, by name. rooms: hold the model. captures: how many graphs were made. record: makes them.
    """

    def __init__(
        self,
        objective: Objective,
        parameters: Callable[[], dict[str, Tensor]],
        rooms: Rooms,
        say: Callable[[str], None],
        record: Record = Graph,
    ) -> None:
        self.objective, self._parameters, self._rooms, self._say, self._record = objective, parameters, rooms, say, record
        self._steps: dict[Kind, _Step] = {}
        self._seen: set[Kind] = set()  # kinds of steps that have been computed, so that their kernels are compiled
        self._age = self._changes = 0  # of the rooms
        self._usable, self.captures = replayable(objective.views), 0

    def __call__(self, model: Model, i: int, step: int, phase: Phase, sh_degree: int) -> Judged:
        if not self._usable or not model.replayable:
            return self.objective(model, i, step, phase, sh_degree)
        drawn = self.objective.drawn_of(i, phase.scale, step)
        row = row_of(model.affine, self.objective.views, i)
        kind = self._kind(model, i, step, phase, sh_degree, drawn, row)
        if kind not in self._seen:
            self._seen.add(kind)
            return self.objective(model, i, step, phase, sh_degree)
        self.objective.relink(model, step)
        self._rooms.hold(model)
        if self._rooms.age != self._age:
            self._age = self._rooms.age
            self._steps.clear()
        if self._rooms.changes != self._changes:
            self._changes = self._rooms.changes
            for other in self._steps.values():
                other.cut = None
        known = self._steps.get(kind)
        if known is not None and known.replays % CHECK_EVERY == CHECK_EVERY - 1 and any(f.overflowed() for f in known.graph.frames):
            del self._steps[kind]  # pairs were left out; the next graph has more room
            return self.objective(model, i, step, phase, sh_degree)
        if known is None:
            try:
                view = OneView(self.objective, kind)
                view.show(i, step, drawn, row)
                known = self._steps[kind] = self._capture(model, view, i, step, phase)
            except RuntimeError as cause:
                self._usable = False
                self._say(f"steps are not replayed as CUDA graphs: {str(cause).splitlines()[0]}")
                return self.objective(model, i, step, phase, sh_degree)
        else:
            known.view.show(i, step, drawn, row)
        known.graph.replay()
        known.replays += 1
        return self._judged(known)

    def _kind(self, model: Model, i: int, step: int, phase: Phase, sh_degree: int, drawn: Drawn | None, row: int | None) -> Kind:
        o, now = self.objective, self.objective.now(step)
        moves = phase.move and model.field is not None
        flow = moves and o.motion_terms.flow_due(model, step, o.total)
        return Kind(
            phase.scale,
            phase.move,
            sh_degree,
            spread=o.spread > 0 and step % EVERY == 0 and step > BEGIN * o.total,
            prior=moves and not model.field.steady and step % PRIOR_EVERY == 0,  # type: ignore[union-attr]
            flow=flow,
            edges=flow and o.motion_terms.may_bend(model),
            target=flow and o.motion_terms.has_target(i),
            drawn=drawn is not None,
            measured=o.measured_depth is not None and o.measured_depth.covers(i),
            held=o.held_depth is not None and o.held_depth.covers(i),
            recorded=row is not None,
            left_out=now.left_out is not None,
            smooth=now.smooth is not None,
        )

    def _capture(self, model: Model, view: OneView, i: int, step: int, phase: Phase) -> _Step:
        objective = OfOneView(self.objective, view)
        twin = self._rooms.whole(model)
        known, names = self._parameters(), list[str]()

        def compute() -> Results:
            with own_leaves(model.field, model.affine):
                leaves = {name: p for name, p in twin.named_parameters().items() if name in known}
                judged = objective(twin, i, step, phase, view.kind.sh_degree)
                found = torch.autograd.grad(judged.loss, list(leaves.values()), allow_unused=True)
            gradients = {name: gradient for name, gradient in zip(leaves, found) if gradient is not None}
            names[:] = gradients
            images = torch.stack([judged.loss, judged.image_loss]), judged.color, judged.target, judged.weight
            results = *images, *(judged.recording or (None, None)), *gradients.values()
            return [result if result is None else result.detach() for result in results]

        graph = self._record(compute, model.device, self._rooms.pool)
        self.captures += 1
        return _Step(graph, view, names)

    def _judged(self, known: _Step) -> Judged:
        losses, color, target, weight, gain, offset, *gradients = known.graph.results
        if known.cut is None:
            now = self._parameters()
            known.cut = [(now[name], g[: len(now[name])]) for name, g in zip(known.names, gradients)]  # type: ignore[index]
        assert losses is not None and color is not None and target is not None
        loss, image_loss = losses.unbind()
        recording = None if gain is None or offset is None else (gain, offset)
        return Judged(loss, image_loss, color, target, weight, recording, gradients=known.cut)
