"""A model and the optimiser of its parameters, kept in step while primitives and the motion are replaced."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from ...model import Model
from ...motion.interface import Motion
from ...primitives import ConvexSet, GaussianSet, PrimitiveSet
from ...settings import TrainingSettings
from ..checkpoint import restore
from ..optimiser import RowAdam
from ..rates import learning_rates


class LearnedModel:
    """``model``, whose parameters ``optimiser`` updates. ``changed``: the step at which primitives or the motion were last replaced.
    ``before_change``: called before they are.

    unit: the viewing distance, world units. lr_scale: factor on the rates of parameters that an earlier stage has already trained.
    """

    def __init__(self, model: Model, settings: TrainingSettings, unit: float, lr_scale: float) -> None:
        self.model, self._settings, self._unit, self._lr_scale = model, settings, unit, lr_scale
        self.optimiser = self._make_optimiser()
        self.changed = 0
        self.before_change: Callable[[], None] = lambda: None

    def replace(self, new: PrimitiveSet, source: Tensor, step: int) -> None:
        """Continue with a new set of a kind. Row i keeps the optimiser's moments of old row ``source[i]``; at -1 it starts afresh."""
        self.before_change()
        self.changed = step
        if isinstance(new, GaussianSet):
            self.model.gaussians = new
        else:
            assert isinstance(new, ConvexSet)
            self.model.convexes = new
        for name, parameter in new.parameters.items():
            self.optimiser.replace(f"{new.KIND}.{name}", parameter, source)

    def renew(self, motion: Motion, step: int) -> None:
        """Continue with another motion, which may share parameters with the previous one."""
        self.before_change()
        self.changed = step
        self.model.motion = motion
        self.model.relink()
        known = self.optimiser.parameters()
        for name, parameter in motion.named_parameters():
            if known.get(f"motion.{name}") is not parameter:
                self.optimiser.replace(f"motion.{name}", parameter, torch.full((parameter.shape[0],), -1, device=parameter.device))

    def tensors(self) -> dict[str, Tensor]:
        """All tensors by name, for a checkpoint."""
        model = self.model
        tensors = {f"parameter/{name}": p for name, p in self.model.named_parameters().items() if not name.startswith("motion.")}
        tensors |= {f"optimiser/{name}": value for name, value in self.optimiser.state().items()}
        tensors |= {f"dynamic/{p.KIND}": p.dynamic for p in (model.gaussians, model.convexes)}
        tensors |= {f"motion/{name}": value for name, value in model.motion.state_dict().items()}
        # None is searched here: training would go on with it, and its result would depend on when checkpoints are written.
        links = {p.KIND: model.known_links(p) for p in (model.gaussians, model.convexes) if len(p)}
        tensors |= {f"link/{kind}": link for kind, link in links.items() if link is not None}
        return tensors

    def load(self, tensors: dict[str, Tensor], state: dict[str, Any]) -> None:
        """Inverse of `tensors`. ``state``: the JSON values of the checkpoint, which include the model's config."""
        restore(self.model, tensors, state)
        self.optimiser = self._make_optimiser()
        self.optimiser.load_state({k.removeprefix("optimiser/"): v for k, v in tensors.items() if k.startswith("optimiser/")})

    def _make_optimiser(self) -> RowAdam:
        named = self.model.named_parameters()
        rates = learning_rates(named, self._settings, self._unit, self._lr_scale, self.model.motion)
        return RowAdam(named, rates, pace=self._pace)

    def _pace(self, parameters: Mapping[str, Tensor]) -> Tensor | None:
        return self.model.motion.pace(parameters)
