"""Steps on the CPU."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from ..control.learned_model import LearnedModel
from ..guard import NonFiniteGuard
from ..optimiser import Rows


@dataclass(frozen=True, eq=False)
class Step:
    """Step ``number`` of a training, from 0, which saw frame ``frame``. loss, image_loss: see `Evaluation`; both are detached."""

    number: int
    frame: int
    loss: Tensor
    image_loss: Tensor


class ImmediateSteps:
    """Applies steps that are finite, and reports each of them, in their order: (step, whether it was accepted). A step is checked before
    the optimiser is called."""

    def __init__(self, learned: LearnedModel, guard: NonFiniteGuard, report: Callable[[Step, bool], None]) -> None:
        self._learned, self._guard, self._report = learned, guard, report

    def apply(self, step: Step, progress: float, frozen: frozenset[str], rows: Rows) -> Tensor:
        """Apply ``step`` if its loss and all gradients are finite, and clear the gradients. progress, frozen, rows: see `RowAdam.step`.

        Returns a bool tensor [] on the model's device: whether the step was rejected. Raises `TrainingDiverged` after too many.
        """
        optimiser = self._learned.optimiser
        accepted = self._guard.accepts(step.loss, optimiser.parameters() | rows.named(), step.number, step.frame)
        if accepted:
            optimiser.step(progress, frozen, rows)
        else:
            optimiser.zero_grad()
        self._report(step, accepted)
        return torch.tensor(not accepted)

    def settle(self) -> None:
        """Report all steps so far. Raises `TrainingDiverged`."""
