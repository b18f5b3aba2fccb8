"""One training run of a stage, with its progress bar, checkpoints and log lines."""

from __future__ import annotations

from typing import Any

from ...pipeline import Context
from ...scene.model import Model
from ...scene.motion.kinds import KINDS
from ...scene.motion.phases import Phase
from ...scene.settings import TrainingSettings
from ...scene.training.log import TrainingLog
from ...scene.training.trainer import Trainer
from ...scene.views import Views
from .rehearsal import Rehearsal, Training


def train(
    ctx: Context, name: str, model: Model, views: Views, phases: list[Phase], settings: TrainingSettings, **options: Any
) -> TrainingLog:
    """Trains ``model`` in place through ``phases``. ``options`` are further arguments of `Trainer`. In a rehearsal, the training is handed
    over instead."""
    if isinstance(ctx, Rehearsal):
        return ctx.hand_over(Training(name, model, views, phases, settings, options))
    with ctx.progress(sum(phase.iterations for phase in phases), name) as bar:
        bar.weigh((phase.iterations, step_seconds(model, views, phase)) for phase in phases)
        trainer = Trainer(
            model,
            views,
            phases,
            settings,
            checkpoints=ctx.checkpoints,
            advance=bar.advance,
            log=ctx.log,
            **options,
        )
        return trainer.run()


def step_seconds(model: Model, views: Views, phase: Phase) -> float:
    """What a step takes on two cores, by the table of motions."""
    kind = KINDS[model.motion.kind]
    return kind.step_seconds + kind.megapixel_seconds * views.width * views.height / 1e6 * phase.scale**2
