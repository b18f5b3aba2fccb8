"""What exports of straight pieces need to know of a model's motion."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ....scene.motion.lifetimes.lifetime import lifetime
from ..bake import Baked


def moves(baked: Baked) -> bool:
    return not baked.model.motion.static


def fades(baked: Baked) -> tuple[Tensor, Tensor, Tensor] | None:
    """Middles and standard deviations, in units of the capture's time, of the lives of all Gaussians of ``baked``, and the opacities that
    they have at most, [n] each; those that do not move are present throughout. None if the model has no lives."""
    model = baked.model
    if model.motion.played_as != "lives":
        return None
    motion: Any = model.motion
    with torch.no_grad():
        span = max(motion.times - 1, 1)
        middles, spreads = [], []
        for one in (model.gaussians, model.convexes):
            life = lifetime(one)
            spread = torch.where(one.dynamic, life.log_spans.double().exp() / span, torch.inf)
            middles.append(torch.where(one.dynamic, life.times.double() / span, 0.0))
            spreads.append(spread)
        gaussians, convexes = model.at(0.0, move=False)
        whole = torch.cat([baked.plain(gaussians).opacities, baked.fit.gaussians(convexes).opacities])
    return torch.cat(middles), torch.cat(spreads), whole.double()
