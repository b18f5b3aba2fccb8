"""What exports of straight pieces need to know of a model's motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

    from ..bake import Baked


def moves(baked: Baked) -> bool:
    return baked.model.field is not None


def fades(baked: Baked) -> tuple[Tensor, Tensor, Tensor] | None:
    """Middles and standard deviations, in units of the capture's time, of the lives of all Gaussians of ``baked``, and the opacities that
    they have at most, [n] each; those that do not move are present throughout. None if the model has no lives."""
    import torch

    from ....scene.motion.free import FreeMotion

    model = baked.model
    if not isinstance(model.field, FreeMotion):
        return None
    with torch.no_grad():
        span = max(model.field.times - 1, 1)
        middles, spreads = [], []
        for one in (model.gaussians, model.convexes):
            spread = torch.where(one.dynamic, one.life.log_spans.double().exp() / span, torch.inf)
            middles.append(torch.where(one.dynamic, one.life.times.double() / span, 0.0))
            spreads.append(spread)
        gaussians, convexes = model.at(0.0, move=False)
        whole = torch.cat([baked.plain(gaussians).opacities, baked.fit.gaussians(convexes).opacities])
    return torch.cat(middles), torch.cat(spreads), whole.double()
