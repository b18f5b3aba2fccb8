"""Steps on the CPU."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ..control.learned_model import LearnedModel
from ..guard import NonFiniteGuard
from ..optimiser import Rows
from .step import Step


class ImmediateSteps:
    """`Steps` that are checked before the optimiser is called."""

    def __init__(self, learned: LearnedModel, guard: NonFiniteGuard, report: Callable[[Step, bool], None]) -> None:
        self._learned, self._guard, self._report = learned, guard, report

    def apply(self, step: Step, progress: float, frozen: frozenset[str], rows: Rows) -> Tensor:
        optimiser = self._learned.optimiser
        accepted = self._guard.accepts(step.loss, optimiser.parameters() | rows.named(), step.number, step.frame)
        if accepted:
            optimiser.step(progress, frozen, rows)
        else:
            optimiser.zero_grad()
        self._report(step, accepted)
        return torch.tensor(not accepted)

    def settle(self) -> None:
        """Nothing is left to report."""
