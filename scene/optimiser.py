"""Adam over named parameters whose rows come and go."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor


class RowAdam:
    """torch's fused Adam with a name for every tensor, and surgery on the rows of its state.

    ``rates`` maps a name to a function of progress in [0, 1] that gives the learning rate.
    """

    def __init__(
        self, parameters: dict[str, Tensor], rates: dict[str, Callable[[float], float]], betas: tuple[float, float] = (0.9, 0.99)
    ) -> None:
        self.rates = rates
        groups = [{"params": [p], "name": name, "lr": rates[name](0.0)} for name, p in parameters.items()]
        self._adam = torch.optim.Adam(groups, lr=1e-3, betas=betas, eps=1e-15, fused=True)

    def parameters(self) -> dict[str, Tensor]:
        return {group["name"]: group["params"][0] for group in self._adam.param_groups}

    def step(self, progress: float, frozen: frozenset[str] = frozenset()) -> None:
        """One step at ``progress`` in [0, 1]. Parameters without a gradient, and those whose name starts with one of ``frozen``, stay."""
        for group in self._adam.param_groups:
            group["lr"] = self.rates[group["name"]](progress)
            if frozen and group["name"].split(".")[0] in frozen:
                group["params"][0].grad = None
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)

    def zero_grad(self) -> None:
        self._adam.zero_grad(set_to_none=True)

    def replace(self, name: str, new: Tensor, source: Tensor) -> None:
        """Swap the tensor ``name`` for ``new``; row i keeps the moments of old row ``source[i]``, or starts at zero where that is -1."""
        for group in self._adam.param_groups:
            if group["name"] != name:
                continue
            old = group["params"][0]
            state = self._adam.state.pop(old, None)
            group["params"][0] = new
            if state:
                kept = source >= 0
                for moment in ("exp_avg", "exp_avg_sq"):
                    rows = torch.zeros_like(new)
                    if kept.any():  # with none kept, the other dimensions may differ as well
                        rows[kept] = state[moment][source[kept]]
                    state[moment] = rows
                self._adam.state[new] = state

    def state(self) -> dict[str, Tensor]:
        """Moments and step counts by name, for a checkpoint."""
        out = {}
        for name, p in self.parameters().items():
            for key, value in self._adam.state.get(p, {}).items():
                out[f"{name}/{key}"] = value
        return out

    def load_state(self, tensors: dict[str, Tensor]) -> None:
        """Inverse of `state`."""
        for name, p in self.parameters().items():
            keys = ("step", "exp_avg", "exp_avg_sq")
            if f"{name}/step" in tensors:
                self._adam.state[p] = {key: tensors[f"{name}/{key}"].clone() for key in keys}
