"""The objective of a step, with its gradients, as a CUDA graph: one replay for the host in place of some hundred operations."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ...cuda.graph import Graph, Results
from ...cuda.leaves import own_leaves
from ...model import Model
from ...motion.phases import Phase
from ..objective import Objective
from ..steps.evaluation import Evaluation
from ..steps.inputs import StepInputs
from .graphs import Compute, Graphs, Record
from .padded_model import PaddedModel


class ReplayedObjective:
    """`Objective` for a model on a GPU, see `Graphs`. parameters: of the optimiser, by name; their names and order stay as long as the
    model's modules do."""

    def __init__(
        self,
        objective: Objective,
        parameters: Callable[[], dict[str, Tensor]],
        memory: PaddedModel,
        say: Callable[[str], None],
        record: Record = Graph,
    ) -> None:
        self.objective, self._parameters = objective, parameters
        self.graphs = Graphs(objective.run.views, memory, "steps", say, record)

    def __call__(self, model: Model, i: int, step: int, phase: Phase, sh_degree: int) -> Evaluation:
        inputs = self.objective.inputs(model, i, step, phase, sh_degree)
        captured = self.graphs.find(model, inputs, self._prepare)
        if captured is None:
            return self.objective.evaluate(model, inputs)
        captured.graph.replay()
        losses, color, target, weight, gain, offset, *gradients = captured.graph.results
        if captured.derived is None:  # the gradients without spare rows
            of = self._parameters().values()
            captured.derived = [(p, gradient[: len(p)]) for p, gradient in zip(of, gradients, strict=True) if gradient is not None]
        assert losses is not None and color is not None and target is not None
        (loss, image_loss), recording = losses, None if gain is None or offset is None else (gain, offset)
        return Evaluation(loss, image_loss, color, target, weight, recording, gradients=captured.derived)

    def _prepare(self, padded: Model) -> Compute:
        def compute(inputs: StepInputs) -> Results:
            with own_leaves(padded.motion, padded.affine):
                named = padded.named_parameters()
                leaves = [named[name] for name in self._parameters()]
                found = self.objective.evaluate(padded, inputs)
                gradients = torch.autograd.grad(found.loss, leaves, allow_unused=True)
            images = torch.stack([found.loss, found.image_loss]), found.color, found.target, found.weight
            results = *images, *(found.recording or (None, None)), *gradients
            return [None if result is None else result.detach() for result in results]

        return compute
