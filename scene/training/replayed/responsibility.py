"""What `measure_responsibility` measures, as CUDA graphs of a frame each."""

from __future__ import annotations

from collections.abc import Callable

from ...cuda.graph import Graph, Results
from ...model import Model
from ...views import Views
from ..control.density import Responsibility, Sums, add_frame, measure_responsibility, responsibility
from ..steps.inputs import Fixed, FrameInputs, frame_inputs
from .graphs import Captured, Compute, Graphs, Record
from .padded_model import PaddedModel


class ReplayedResponsibility:
    """`measure_responsibility` for a model on a GPU, in the ``memory`` of `ReplayedObjective`; see `Graphs`."""

    def __init__(self, views: Views, memory: PaddedModel, say: Callable[[str], None], record: Record = Graph) -> None:
        self.graphs = Graphs(views, memory, "measurements", say, record)

    def __call__(self, model: Model, views: Views, frames: list[int], move: bool, scale: float = 1.0) -> Responsibility:
        fixed, used = Fixed(move, model.sh_degree, views.size(scale)), dict[Captured, Sums]()
        for i in frames:
            inputs = fixed, frame_inputs(views, views.rasterizer_camera(i, scale), model.affine, i, scale)
            captured = self.graphs.find(model, inputs, self._prepare)
            if captured is None:
                return measure_responsibility(model, views, frames, move, scale)
            if captured not in used:
                found = captured.graph.results
                used[captured] = Sums(*zip(found[::2], found[1::2]))  # type: ignore[arg-type]
                for one in found:
                    assert one is not None
                    one.zero_()
            captured.graph.replay()
        overflowed = [captured for captured in used if captured.overflowed()]
        for captured in overflowed:
            self.graphs.forget(captured)
        if overflowed:
            return measure_responsibility(model, views, frames, move, scale)
        total = Sums.none(model)
        for sums in used.values():
            for to, of in zip(total, sums):
                for a, b in zip(to, of):
                    a.add_(b[: len(a)])
        return responsibility(total, len(frames), scale)

    def _prepare(self, padded: Model) -> Compute:
        sums = Sums.none(padded)

        def compute(inputs: tuple[Fixed, FrameInputs]) -> Results:
            add_frame(sums, padded, inputs[1], inputs[0].move)
            return [one for pair in sums for one in pair]

        return compute
