"""The training step with every kernel of ours replaced: the same trainer, composed of torch operations."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import torch
from e4dgs.scene.losses import appearance, flow_loss
from e4dgs.scene.model import Model
from e4dgs.scene.training import objective
from e4dgs.scene.training.optimiser import ALL_ROWS, Rows
from e4dgs.scene.training.trainer import Trainer
from torch import Tensor

from .field import TorchField
from .loss import torch_loss
from .rasterizer import rasterize_torch


class TorchAdam:
    """torch's fused Adam behind the part of `RowAdam` that a step uses."""

    def __init__(self, parameters: dict[str, Tensor], rates: dict[str, Callable[[float], float]]) -> None:
        self.rates = rates
        groups = [{"params": [p], "name": name, "lr": rates[name](0.0)} for name, p in parameters.items()]
        self._adam = torch.optim.Adam(groups, lr=1e-3, betas=(0.9, 0.99), eps=1e-15, fused=True)

    def parameters(self) -> dict[str, Tensor]:
        return {group["name"]: group["params"][0] for group in self._adam.param_groups}

    def step(self, progress: float, frozen: frozenset[str] = frozenset(), rows: Rows = ALL_ROWS) -> None:
        assert rows is ALL_ROWS  # this step computes with all Gaussians
        for group in self._adam.param_groups:
            group["lr"] = self.rates[group["name"]](progress)
        self._adam.step()
        self.zero_grad()

    def zero_grad(self) -> None:
        self._adam.zero_grad(set_to_none=True)


def copy_of(model: Model) -> Model:
    """The same model on memory of its own."""
    arrays = {name: np.array(value) for name, value in model.to_arrays().items()}
    return Model.from_arrays(arrays, model.config)


def composed_of_torch(model: Model) -> Model:
    """``model`` with its field replaced by the composition; the Gaussians are shared."""
    model.motion = TorchField(model.motion.state_dict())
    return model


def with_torch_adam(made: Trainer) -> None:
    """Replaces a trainer's optimiser by torch's, with the same learning rates."""
    made.learned.optimiser = TorchAdam(made.learned.optimiser.parameters(), made.learned.optimiser.rates)  # type: ignore[assignment]


@contextmanager
def torch_kernels() -> Iterator[None]:
    """While it lasts, training renders with the torch rasterizer and judges with the torch loss."""
    kept = objective.rasterize, flow_loss.rasterize, appearance.photometric_loss
    objective.rasterize = flow_loss.rasterize = rasterize_torch  # type: ignore[assignment]
    appearance.photometric_loss = torch_loss
    try:
        yield
    finally:
        objective.rasterize, flow_loss.rasterize, appearance.photometric_loss = kept
