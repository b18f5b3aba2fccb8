"""Adam over named parameters whose rows are added and removed during training."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from .. import _kernels
from ..primitives import PrimitiveSet

EPSILON = 1e-15


@dataclass(frozen=True)
class Rows:
    """Copies of the rows ``index`` [m] int64 of some parameters, by the optimiser's names. No row occurs twice."""

    index: Tensor | None
    parameters: dict[str, Tensor]

    @classmethod
    def of(cls, copy: PrimitiveSet, index: Tensor) -> Rows:
        """The rows ``index`` of one kind of primitives, copied to the set ``copy``."""
        return cls(index, {f"{copy.KIND}.{name}": p for name, p in copy.parameters.items()})

    def gradient(self, name: str, parameter: Tensor) -> tuple[Tensor | None, Tensor | None]:
        """The gradient of the parameter ``name`` and the rows that it is of; None if that is all of them."""
        copied = self.parameters[name].grad if name in self.parameters else None
        if copied is None or self.index is None:
            return parameter.grad, None
        if parameter.grad is None:
            return copied, self.index
        return parameter.grad.index_add(0, self.index, copied), None


ALL_ROWS = Rows(None, {})


class RowAdam:
    """Adam over named tensors that updates only the rows (first axis) that got a gradient, and whose rows can be replaced.

    A row whose gradient is all zero was seen by no ray: it keeps its value and its moments. ``rates`` maps each name to a function of
    progress in [0, 1] that returns the learning rate. Parameters are contiguous float32 on the CPU or on a CUDA device; a step does not
    synchronise the device. Step number and rate are host values: a CUDA graph would repeat those it was captured with.
    """

    def __init__(
        self, parameters: dict[str, Tensor], rates: dict[str, Callable[[float], float]], betas: tuple[float, float] = (0.9, 0.99)
    ) -> None:
        self.rates, self.betas = rates, betas
        self._parameters = dict(parameters)
        self._state: dict[str, dict[str, Tensor]] = {}

    def parameters(self) -> dict[str, Tensor]:
        return dict(self._parameters)

    def step(self, progress: float, frozen: frozenset[str] = frozenset(), rows: Rows = ALL_ROWS) -> None:
        """One step at ``progress`` in [0, 1]. Parameters without a gradient or whose owner (first part of the name) is ``frozen`` stay.
        ``rows``: copies of some rows of parameters, whose gradients are added to those of the parameters."""
        for name, p in self._parameters.items():
            grad, index = rows.gradient(name, p)
            if grad is None or not grad.numel() or name.split(".")[0] in frozen:
                continue
            state = self._state.get(name)
            if state is None:
                state = self._state[name] = {"step": torch.zeros(()), "exp_avg": torch.zeros_like(p), "exp_avg_sq": torch.zeros_like(p)}
            state["step"] += 1
            tensors = p.detach(), grad.contiguous(), state["exp_avg"], state["exp_avg_sq"]
            _step_rows(*tensors, index, int(state["step"]), self.rates[name](progress), self.betas)
        self.zero_grad()

    def zero_grad(self) -> None:
        for p in self._parameters.values():
            p.grad = None

    def replace(self, name: str, new: Tensor, source: Tensor) -> None:
        """Replace the tensor ``name`` by ``new``. Row i keeps the moments of old row ``source[i]``, or starts at zero if that is -1."""
        if name not in self._parameters:
            return
        self._parameters[name] = new
        state = self._state.get(name)
        if state is None:
            return
        kept = source >= 0
        for moment in ("exp_avg", "exp_avg_sq"):
            rows = torch.zeros_like(new, requires_grad=False)
            if kept.any():  # if no row is kept, the other dimensions may differ, too
                rows[kept] = state[moment][source[kept]]
            state[moment] = rows

    def state(self) -> dict[str, Tensor]:
        """Moments and step counts by name, for a checkpoint."""
        return {f"{name}/{key}": value for name, state in self._state.items() for key, value in state.items()}

    def load_state(self, tensors: dict[str, Tensor]) -> None:
        """Inverse of `state`."""
        for name, p in self._parameters.items():
            if f"{name}/step" in tensors:
                state = {"step": tensors[f"{name}/step"].to("cpu", copy=True)}
                self._state[name] = state | {key: tensors[f"{name}/{key}"].to(p.device, copy=True) for key in ("exp_avg", "exp_avg_sq")}


def _step_rows(
    parameter: Tensor, grad: Tensor, first: Tensor, second: Tensor, index: Tensor | None, step: int, rate: float, betas: tuple[float, float]
) -> None:
    """One step with the kernel for the parameter's device, of the rows ``index`` or of all."""
    if parameter.device.type == "cuda":
        from ...rasterizer.cuda.runtime import launcher_for
        from ..cuda.adam import adam_rows

        adam_rows(launcher_for(parameter.device), parameter, grad, first, second, step, rate, *betas, EPSILON)
    else:
        _kernels.adam_rows(parameter, grad, first, second, index, step, rate, *betas, EPSILON, torch.get_num_threads())
