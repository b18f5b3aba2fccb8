"""What applies the steps of a training."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from ..optimiser import Rows


@dataclass(frozen=True, eq=False)
class Step:
    """Step ``number`` of a training, from 0, which saw frame ``frame``. loss, image_loss: see `Evaluation`; both are detached."""

    number: int
    frame: int
    loss: Tensor
    image_loss: Tensor


class Steps(Protocol):
    """Applies steps that are finite, and reports each of them, in their order: (step, whether it was accepted)."""

    def apply(self, step: Step, progress: float, frozen: frozenset[str], rows: Rows) -> Tensor:
        """Apply ``step`` if its loss and all gradients are finite, and clear the gradients. progress, frozen, rows: see `RowAdam.step`.

        Returns a bool tensor [] on the model's device: whether the step was rejected. Raises `TrainingDiverged` after too many.
        """
        ...

    def settle(self) -> None:
        """Report all steps so far. Raises `TrainingDiverged`."""
        ...
