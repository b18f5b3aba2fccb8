"""A first, short training of control nodes on very small images, in which they find the motion before anything has detail."""

from __future__ import annotations

from ...pipeline import Context
from ...scene.model import Model
from ...scene.training.checkpoint import load_checkpoint
from ...scene.training.recipe import FIRST_MOTION
from ...scene.training.schedule import first_motion_phases, first_motion_steps
from ...scene.views import Views
from ..shared.train import train
from .settings import CoarseSettings

PART = "first motion"
MOST_GAUSSIANS = 5000  # half of the pixels of a 400x400 image at a quarter of its size


def find_first_motion(ctx: Context, model: Model, views: Views, settings: CoarseSettings, steps: int, small: bool) -> None:
    """Trains ``model`` in place before the ``steps`` steps of `coarse`. small: whether even the full images are small.

    Nodes that start on detailed images settle where a limb is folded or swapped with another. No gradient leads out of there, and the
    prior towards rigid parts holds them in it, so it is off here.
    """
    found = load_checkpoint(ctx.checkpoints)
    if found is not None and found[1].get("part", "") != PART:
        return  # the checkpoint is from after this training
    phases = first_motion_phases(first_motion_steps(steps), small)
    train(
        ctx,
        PART,
        model,
        views,
        phases,
        settings.model_copy(update={"rigid_weight": 0.0}),
        budget=min(MOST_GAUSSIANS, settings.budget or MOST_GAUSSIANS),
        recipe=FIRST_MOTION,
        part=PART,
    )
