"""What `measure_responsibility` measures, as CUDA graphs of a frame each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ...colour import row_of
from ...cuda.graph import Graph, Recorded, Results
from ...model import Model
from ...views import Views
from ..control.density import Responsibility, Sums, add_frame, measure_responsibility, responsibility
from ..objective import Objective
from .objective import Record, replayable
from .one_view import Kind, OneView
from .rooms import Rooms


@dataclass(eq=False)
class _Frame:
    graph: Recorded
    view: OneView
    sums: Sums


class ReplayedResponsibility:
    """`measure_responsibility` for a model on a GPU, in the ``rooms`` of `ReplayedObjective`. The first call of a kind is computed as
    usual, the second one is captured, later ones are replays."""

    def __init__(self, objective: Objective, rooms: Rooms, say: Callable[[str], None], record: Record = Graph) -> None:
        self._objective, self._rooms, self._say, self._record = objective, rooms, say, record
        self._frames: dict[Kind, _Frame] = {}
        self._seen: set[Kind] = set()
        self._age, self._usable = 0, replayable(objective.views)

    def __call__(self, model: Model, views: Views, frames: list[int], move: bool, scale: float = 1.0) -> Responsibility:
        rows = [row_of(model.affine, views, i) for i in frames]
        kind = Kind(scale, move, model.sh_degree, recorded=rows[0] is not None)
        covered = self._usable and model.motion.replayable and all((row is None) == (rows[0] is None) for row in rows)
        if not covered or kind not in self._seen:
            self._seen.add(kind)
            return measure_responsibility(model, views, frames, move, scale)
        self._rooms.hold(model)
        if self._rooms.age != self._age:
            self._age = self._rooms.age
            self._frames.clear()
        known = self._frames.get(kind)
        if known is None:
            view = OneView(self._objective, kind)
            view.show(frames[0], 0, None, rows[0])
            try:
                known = self._frames[kind] = self._capture(model, view)
            except RuntimeError as cause:
                self._usable = False
                self._say(f"measurements are not replayed as CUDA graphs: {str(cause).splitlines()[0]}")
                return measure_responsibility(model, views, frames, move, scale)
        for some in known.sums:
            for one in some:
                one.zero_()
        for i, row in zip(frames, rows):
            known.view.show(i, 0, None, row)
            known.graph.replay()
        if any(frame.overflowed() for frame in known.graph.frames):
            del self._frames[kind]  # pairs were left out; the next graph has more room
            return measure_responsibility(model, views, frames, move, scale)
        n, m = len(model.gaussians), len(model.convexes)
        return responsibility(Sums(*((a[:n], b[:m]) for a, b in known.sums)), len(frames), scale)

    def _capture(self, model: Model, view: OneView) -> _Frame:
        twin, kind = self._rooms.whole(model), view.kind
        sums = Sums.none(twin)

        def compute() -> Results:
            add_frame(sums, twin, view, 0, kind.move, kind.scale, view.row())  # type: ignore[arg-type]
            return []

        return _Frame(self._record(compute, model.device, self._rooms.pool), view, sums)
