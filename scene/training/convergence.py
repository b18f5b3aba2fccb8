"""Whether training still improves, judged by the image loss smoothed over the steps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

CONVERGED = 0.002  # relative improvement over `patience` steps below which a stage has converged
EVERY = 20  # steps between two points of the curve


class SmoothedLoss:
    """Exponential moving average of the loss over all steps taken."""

    def __init__(self) -> None:
        self._mean: float | None = None  # of all steps except those waiting
        self._waiting: list[Tensor] = []  # still on the device: reading one would wait for all work queued before it

    def add(self, loss: Tensor) -> None:
        self._waiting.append(loss)

    def value(self) -> float:
        """The average so far; 0 before the first step."""
        if self._waiting:
            for value in torch.stack(self._waiting).tolist():
                self._mean = value if self._mean is None else 0.98 * self._mean + 0.02 * value
            self._waiting.clear()
        return 0.0 if self._mean is None else self._mean

    def load(self, value: float) -> None:
        """Continue from an earlier `value`."""
        self._mean = value


def flat(curve: Sequence[Sequence[float]], patience: int) -> bool:
    """Whether the loss of the last ``patience`` steps is not noticeably better than that of the ``patience`` steps before them.

    curve: rows of (step, loss), one every `EVERY` steps."""
    rows = patience // EVERY
    if len(curve) < 2 * rows:
        return False
    values = [value for _, value in curve]
    before, now = float(np.mean(values[-2 * rows : -rows])), float(np.mean(values[-rows:]))
    return now > before * (1 - CONVERGED)
