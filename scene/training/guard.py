"""A step that went wrong is rolled back and counted; a training that keeps going wrong stops with a clear message."""

from __future__ import annotations

import torch
from torch import Tensor

MOST_IN_A_ROW = 20


class TrainingDiverged(RuntimeError):
    """The loss or its gradients stayed non-finite."""


def all_finite(values: Tensor) -> bool:
    """Whether every number is finite. A sum tells ten times faster than a look at each; only one that overflowed needs the look."""
    return bool(torch.isfinite(values.sum())) or bool(torch.isfinite(values).all())


class NonFiniteGuard:
    """Checks loss and gradients before the optimiser moves anything, so a bad step never reaches the parameters."""

    def __init__(self) -> None:
        self.count = 0
        self._in_a_row = 0

    def accepts(self, loss: Tensor, parameters: dict[str, Tensor], iteration: int, frame: int) -> bool:
        """True if the step may be taken. Raises `TrainingDiverged` after too many refusals in a row, naming step, frame and field."""
        grads = {name: p.grad for name, p in parameters.items() if p.grad is not None}
        # One question for all: each answer that leaves a GPU waits for all that was asked of it before.
        sums = torch.stack([loss.detach(), *(g.sum() for g in grads.values())])
        doubtful = not bool(torch.isfinite(sums).all())
        bad = [name for name, g in grads.items() if not all_finite(g)] if doubtful else []
        if not doubtful or (bool(torch.isfinite(loss)) and not bad):  # a sum may overflow though no number has
            self._in_a_row = 0
            return True
        self.count += 1
        self._in_a_row += 1
        if self._in_a_row >= MOST_IN_A_ROW:
            where = f"gradients of {', '.join(bad)}" if bad else f"the loss ({float(loss)})"
            raise TrainingDiverged(
                f"step {iteration}, frame {frame}: {where} not finite, {MOST_IN_A_ROW} steps in a row. "
                "Lower the learning rates (--set coarse.lr_means=..., coarse.lr_field=...) or check the capture's poses."
            )
        return False
