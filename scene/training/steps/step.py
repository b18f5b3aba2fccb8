"""What takes the steps of a training."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from ..optimiser import Rows


@dataclass(frozen=True, eq=False)
class Step:
    """Step ``number`` of a training, from 0, which saw frame ``frame``. loss, image_loss: see `Judged`; both are detached."""

    number: int
    frame: int
    loss: Tensor
    image_loss: Tensor


class Steps(Protocol):
    """Takes steps that are finite, and reports each of them, in their order: (step, whether it was taken)."""

    def take(self, step: Step, progress: float, frozen: frozenset[str], rows: Rows) -> Tensor:
        """Take ``step`` if its loss and all gradients are finite, and clear the gradients. progress, frozen, rows: see `RowAdam.step`.

        Returns a bool tensor [] on the model's device: whether the step was not taken. Raises `TrainingDiverged` after too many of them.
        """
        ...

    def settle(self) -> None:
        """Report all steps so far. Raises `TrainingDiverged`."""
        ...
