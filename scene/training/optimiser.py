"""Adam over named parameters whose rows are added and removed during training."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from .. import _kernels
from ..primitives import PrimitiveSet

EPSILON = 1e-15
MOST_TABLES = 64


@dataclass(frozen=True)
class Rows:
    """Copies of the rows ``index`` [m] int64 of some parameters, by the optimiser's names. No row occurs twice."""

    index: Tensor | None
    parameters: dict[str, Tensor]

    @classmethod
    def of(cls, copy: PrimitiveSet, index: Tensor) -> Rows:
        """The rows ``index`` of one kind of primitives, copied to the set ``copy``."""
        return cls(index, {f"{copy.KIND}.{name}": p for name, p in copy.parameters.items()})

    def named(self) -> dict[str, Tensor]:
        """The copies, by names that tell them from the parameters themselves."""
        return {f"{name} in view": p for name, p in self.parameters.items()}

    def gradient(self, name: str, parameter: Tensor) -> tuple[Tensor | None, Tensor | None]:
        """The gradient of the parameter ``name`` and the rows that it is of; None if that is all of them."""
        copied = self.parameters[name].grad if name in self.parameters else None
        if copied is None or self.index is None:
            return parameter.grad, None
        if parameter.grad is None:
            return copied, self.index
        return parameter.grad.index_add(0, self.index, copied), None


ALL_ROWS = Rows(None, {})


@dataclass
class Moments:
    """What Adam remembers of a parameter: the steps it took, and the moments of its gradient, in the parameter's shape."""

    steps: int
    first: Tensor
    second: Tensor


@dataclass(frozen=True, eq=False)
class Attempt:
    """A step on a CUDA device, which was taken only if all was finite.

    names: what was checked. bad [1 + n] bool, on the device: whether the step was not taken; then, of each name, whether it was not finite.
    counted: the parameters that count the step."""

    names: list[str]
    bad: Tensor
    counted: list[str]


class RowAdam:
    """Adam over named tensors that updates only the rows (first axis) that got a gradient, and whose rows can be replaced.

    A row whose gradient is all zero was seen by no ray: it keeps its value and its moments. ``rates`` maps each name to a function of
    progress in [0, 1] that returns the learning rate. ``pace`` returns, from the parameters of m primitives by their last names, a factor
    [m] on the rates of all that belongs to them, or None. Parameters are contiguous float32, all on the CPU or all on one CUDA device,
    which a step does not synchronise.
    """

    def __init__(
        self,
        parameters: dict[str, Tensor],
        rates: dict[str, Callable[[float], float]],
        betas: tuple[float, float] = (0.9, 0.99),
        pace: Callable[[dict[str, Tensor]], Tensor | None] = lambda parameters: None,
    ) -> None:
        self.rates, self.betas, self._pace = rates, betas, pace
        self._parameters = dict(parameters)
        self._device = next((p.device for p in parameters.values()), torch.device("cpu"))
        self._state: dict[str, Moments] = {}
        self._tables: dict[tuple[Any, ...], Any] = {}  # on a CUDA device, what its kernels read, by where that is
        self._paces: dict[str, Tensor | None] = {}

    def parameters(self) -> dict[str, Tensor]:
        return dict(self._parameters)

    def step(self, progress: float, frozen: frozenset[str] = frozenset(), rows: Rows = ALL_ROWS) -> None:
        """One step at ``progress`` in [0, 1]. Parameters without a gradient or whose owner (first part of the name) is ``frozen`` stay.
        ``rows``: copies of some rows of parameters, whose gradients are added to those of the parameters; on the CPU alone.

        On a CUDA device, see `step_if_finite`."""
        if self._device.type == "cuda":
            assert rows.index is None, "a CUDA device computes with all rows"
            self.step_if_finite({}, progress, frozen)
            return
        paces: dict[tuple[str, bool], Tensor | None] = {}
        steps = []
        for name, p in self._parameters.items():
            grad, index = rows.gradient(name, p)
            if grad is None or not grad.numel() or name.split(".")[0] in frozen:
                continue
            state = self._counted(name, p)
            kind = name.split(".")[0], index is not None
            if kind not in paces:  # the same for all that belongs to a kind, and of copied rows alone where there are some
                paces[kind] = self._pace_of(kind[0], self._parameters if index is None else rows.parameters)
            tensors = p.detach(), grad.contiguous(), state.first, state.second, paces[kind]
            steps.append((*tensors, index, state.steps, self.rates[name](progress)))
        _kernels.adam(steps, *self.betas, EPSILON, torch.get_num_threads())
        self.zero_grad()

    def step_if_finite(self, others: dict[str, Tensor], progress: float, frozen: frozenset[str] = frozenset()) -> Attempt:
        """The same on a CUDA device, with a constant number of launches. Nothing changes there if any number of any gradient, be it of a
        frozen parameter, or of ``others`` is not finite. The step is counted until `uncount` takes that back."""
        from ...rasterizer.cuda.runtime import launcher_for
        from ..cuda.adam import Table, Update

        gradients = {name: p.grad.contiguous() for name, p in self._parameters.items() if p.grad is not None and p.grad.numel()}
        trained = [name for name in gradients if name.split(".")[0] not in frozen]
        states = {name: self._counted(name, self._parameters[name]) for name in trained}
        paces = {kind: self._kept_pace(kind) for kind in {name.split(".")[0] for name in trained}}
        # What the table of a step holds besides rates and steps; steps that are replayed have all of it in the same places.
        used = *others.values(), *(p for p in paces.values() if p is not None), *(m for s in states.values() for m in (s.first, s.second))
        of_gradients = ((name, g.shape, g.data_ptr(), self._parameters[name].data_ptr()) for name, g in gradients.items())
        key = frozen, *(tensor.data_ptr() for tensor in used), *of_gradients
        table = self._tables.get(key)
        if table is None:
            updates = [Update(other) for other in others.values()]
            for name, gradient in gradients.items():
                update, state = Update(gradient), states.get(name)
                if state is not None:
                    pace = paces[name.split(".")[0]]
                    update = Update(gradient, self._parameters[name].detach(), state.first, state.second, pace=pace)
                updates.append(update)
            if len(self._tables) >= MOST_TABLES:
                self._tables.clear()
            table = self._tables[key] = Table(updates, self._device)
        steps = [(1, 0.0)] * len(others)
        steps += [(states[name].steps, self.rates[name](progress)) if name in states else (1, 0.0) for name in gradients]
        bad = table.step(launcher_for(self._device), steps, *self.betas, EPSILON)
        self.zero_grad()
        return Attempt([*others, *gradients], bad, trained)

    def uncount(self, attempt: Attempt) -> None:
        """Correct the step counts for an attempt that turned out not to be finite."""
        for name in attempt.counted:
            self._state[name].steps -= 1

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
        some = bool(kept.any())  # if no row is kept, the other dimensions may differ, too

        def carried(moment: Tensor) -> Tensor:
            rows = torch.zeros_like(new, requires_grad=False)
            if some:
                rows[kept] = moment[source[kept]]
            return rows

        state.first, state.second = carried(state.first), carried(state.second)

    def state(self) -> dict[str, Tensor]:
        """Moments and step counts by name, for a checkpoint."""
        return {
            f"{name}/{key}": value
            for name, state in self._state.items()
            for key, value in (("step", torch.tensor(float(state.steps))), ("exp_avg", state.first), ("exp_avg_sq", state.second))
        }

    def load_state(self, tensors: dict[str, Tensor]) -> None:
        """Inverse of `state`."""
        for name, p in self._parameters.items():
            if f"{name}/step" in tensors:
                moments = (tensors[f"{name}/{key}"].to(p.device, copy=True) for key in ("exp_avg", "exp_avg_sq"))
                self._state[name] = Moments(int(tensors[f"{name}/step"]), *moments)

    def _pace_of(self, kind: str, parameters: dict[str, Tensor]) -> Tensor | None:
        """The factors on the rates of the rows of a kind of primitives, of which ``parameters`` has all rows or some; None: 1."""
        return self._pace({name.split(".", 1)[1]: p for name, p in parameters.items() if name.startswith(f"{kind}.")})

    def _kept_pace(self, kind: str) -> Tensor | None:
        """`_pace_of` all rows, where the last one was if it has as many."""
        pace, kept = self._pace_of(kind, self._parameters), self._paces.get(kind)
        if pace is not None and kept is not None and kept.shape == pace.shape:
            pace = kept.copy_(pace)
        self._paces[kind] = pace
        return pace

    def _counted(self, name: str, parameter: Tensor) -> Moments:
        """What is remembered of a parameter that takes a step, which is counted."""
        state = self._state.get(name)
        if state is None:
            state = self._state[name] = Moments(0, torch.zeros_like(parameter), torch.zeros_like(parameter))
        state.steps += 1
        return state
