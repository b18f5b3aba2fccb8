"""Non-finite steps are skipped and counted; training that produces too many in a row stops with a clear message."""

from __future__ import annotations

import torch
from torch import Tensor

MOST_IN_A_ROW = 20


class TrainingDiverged(RuntimeError):
    """The loss or its gradients stayed non-finite."""


def all_finite(values: Tensor) -> bool:
    """Whether every number is finite. Testing the sum is ten times faster; each number is tested only if the sum is not finite."""
    return bool(torch.isfinite(values.sum())) or bool(torch.isfinite(values).all())


class NonFiniteGuard:
    """Checks loss and gradients before the optimiser changes anything, so that a bad step never reaches the parameters."""

    def __init__(self) -> None:
        self.count = 0
        self._in_a_row = 0

    def accepts(self, loss: Tensor, parameters: dict[str, Tensor], iteration: int, frame: int) -> bool:
        """Whether the step may be taken. Raises `TrainingDiverged`, naming step, frame and cause, after too many rejections in a row."""
        grads = {name: p.grad for name, p in parameters.items() if p.grad is not None}
        sums = torch.stack([loss.detach(), *(g.sum() for g in grads.values())])
        doubtful = not bool(torch.isfinite(sums).all())
        bad = [name for name, g in grads.items() if not all_finite(g)] if doubtful else []
        # A sum may overflow although every number is finite.
        finite = not doubtful or (bool(torch.isfinite(loss)) and not bad)
        self.judged(finite, bad, loss, iteration, frame)
        return finite

    def judged(self, finite: bool, bad: list[str], loss: Tensor, iteration: int, frame: int) -> None:
        """Count a step that was judged elsewhere. ``bad``: names whose gradients were not finite. Raises as `accepts` does."""
        if finite:
            self._in_a_row = 0
            return
        self.count += 1
        self._in_a_row += 1
        if self._in_a_row >= MOST_IN_A_ROW:
            where = f"gradients of {', '.join(bad)}" if bad else f"the loss ({float(loss)})"
            raise TrainingDiverged(
                f"step {iteration}, frame {frame}: {where} not finite, {MOST_IN_A_ROW} steps in a row. "
                "Lower the learning rates (--set train.lr_means=... and the other lr_ settings) or check the capture's poses."
            )
