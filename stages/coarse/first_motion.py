"""What some motions train before the training proper: a first, short training in which they find the motion."""

from __future__ import annotations

from ...pipeline import Context
from ...scene.model import Model
from ...scene.training.checkpoint import load_checkpoint
from ...scene.views import Views
from ..shared.train import train
from .settings import CoarseSettings


def find_first_motion(ctx: Context, model: Model, views: Views, settings: CoarseSettings, steps: int, small: bool) -> None:
    """Trains ``model`` in place before the ``steps`` steps of `coarse`, if its motion asks for that. small: whether even the full images
    are small."""
    first = model.motion.first_training(settings.strategy, steps, small)
    if first is None:
        return
    found = load_checkpoint(ctx.checkpoints)
    if found is not None and found[1].get("part", "") != first.name:
        return  # the checkpoint is from after this training
    train(
        ctx,
        first.name,
        model,
        views,
        first.phases,
        settings.model_copy(update=first.changes),
        budget=min(first.budget, settings.budget or first.budget),
        recipe=first.recipe,
        part=first.name,
    )
