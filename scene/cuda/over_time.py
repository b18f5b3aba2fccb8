"""Functions of a few times that a network computes. On a GPU they are CUDA graphs: the host would take longer than the GPU."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from .captured import Captured

Function = Callable[[Tensor], tuple[Tensor, ...]]


class OverTime:
    """``function`` of times [T], each clamped to [0, 1], and of the parameters of what ``module`` returns.

    What else the function reads must not change; `forget` after it has.
    """

    def __init__(self, function: Function, module: Callable[[], nn.Module]) -> None:
        self._function, self._module = function, module
        self._captured: dict[int, Function] = {}

    def __call__(self, times: Sequence[float] | Tensor) -> tuple[Tensor, ...]:
        if isinstance(times, Tensor):  # on the device, as they are while a graph is captured that contains this function
            return self._function(times.clamp(0, 1))
        like = next(self._module().parameters())
        given, device = torch.tensor([min(max(float(t), 0.0), 1.0) for t in times], dtype=like.dtype), like.device
        if device.type != "cuda" or not torch.backends.cuda.is_built() or torch.cuda.is_current_stream_capturing():
            return self._function(given.to(device, non_blocking=True))
        captured = self._captured.get(len(times))
        if captured is None:
            captured = self._captured[len(times)] = Captured(self._function, self._module(), given.to(device))
        return captured(given)

    def forget(self) -> None:
        """Capture again at the next call."""
        self._captured.clear()
