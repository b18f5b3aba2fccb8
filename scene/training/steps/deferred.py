"""Steps on a CUDA device, which runs behind the host."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..control.learned_model import LearnedModel
from ..guard import NonFiniteGuard
from ..optimiser import Attempt, Rows
from .immediate import ImmediateSteps, Step

LATEST = 8  # steps after which an answer is waited for


@dataclass(frozen=True, eq=False)
class _Sent:
    """A step that the device has been sent. answer: its losses and what its attempt found, in memory of the host once ``there`` has
    happened. The losses on the device are replaced by those of the next step."""

    step: Step
    attempt: Attempt
    answer: Tensor
    there: torch.cuda.Event


class DeferredSteps(ImmediateSteps):
    """Steps that the device checks and applies by itself. What it found is read some steps later, so that the host does not wait for it.

    Until then, a step that was rejected counts for the bias correction of Adam in the steps after it.
    """

    def __init__(self, learned: LearnedModel, guard: NonFiniteGuard, report: Callable[[Step, bool], None]) -> None:
        super().__init__(learned, guard, report)
        self._sent: deque[_Sent] = deque()

    def apply(self, step: Step, progress: float, frozen: frozenset[str], rows: Rows) -> Tensor:
        assert rows.index is None, "a CUDA device computes with all rows"
        attempt = self._learned.optimiser.step_if_finite({"the loss": step.loss}, progress, frozen)
        # One copy; to read a number on the device would be to wait for all that was queued since.
        losses = torch.stack([step.loss.float(), step.image_loss.float()])
        found = torch.cat([losses.view(torch.uint8), attempt.bad.view(torch.uint8)])
        answer, there = found.to("cpu", non_blocking=True), torch.cuda.Event()
        there.record(torch.cuda.current_stream(attempt.bad.device))
        self._sent.append(_Sent(step, attempt, answer, there))
        while self._sent and (len(self._sent) > LATEST or self._sent[0].there.query()):
            self._read()
        return attempt.bad[0]

    def settle(self) -> None:
        while self._sent:
            self._read()

    def _read(self) -> None:
        """Read the oldest answer."""
        sent = self._sent.popleft()
        sent.there.synchronize()
        loss, image_loss = sent.answer[:8].clone().view(torch.float32)
        step, (bad, *each) = replace(sent.step, loss=loss, image_loss=image_loss), sent.answer[8:].tolist()
        if bad:
            self._learned.optimiser.uncount(sent.attempt)
        gradients = [name for name, found in zip(sent.attempt.names[1:], each[1:]) if found]
        self._guard.judged(not bad, gradients, step.loss, step.number, step.frame)
        self._report(step, not bad)
