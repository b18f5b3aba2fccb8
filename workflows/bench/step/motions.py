"""A training step as captures take it: control nodes before one camera at a time; a rig, of which all or a fifth moves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from ....scene.model import Model
from ....scene.motion.free import FreeMotion
from ....scene.settings import TrainingSettings
from ....scene.training.recipe import RECIPES
from ....scene.training.schedule import Phase
from ....scene.training.trainer import Trainer
from ....scene.views import Views
from ....stages.training.motions import make_nodes
from ..rows import Bench, Check, Measured
from ..timing import interleaved
from .training import BEGUN, PERIOD, STEPS, make_model, views_of

NODES_COUNT, RIG_COUNT = 40_000, 60_000
NODES_BAR, RIG_BAR = 30.0, 80.0  # ms a step on two cores, 400x400 and 640x360
MOVING = 0.2  # of the rig's Gaussians, where most stand still
HALF = 0.5  # of the time of a step in which everything moves


def measure(bench: Bench) -> Measured:
    views, masks, name = views_of(bench)
    rig = len(np.unique(views.camera)) > 1 and len(np.unique(views.time)) < len(views.train)
    contenders = {}
    if rig:
        contenders["a rig, lives"] = _steps(_model(bench, views, masks, "free"), views)
        contenders["a rig, planes, all of it moves"] = _steps(_model(bench, views, masks, "planes"), views)
        contenders["a rig, planes, a fifth moves"] = _steps(_model(bench, views, masks, "planes", MOVING), views)
    else:
        contenders["control nodes"] = _steps(_model(bench, views, masks, "nodes"), views)
    times = interleaved(bench, contenders)
    ms = {what: 1e3 * t.best / PERIOD for what, t in times.items()}
    if rig:
        share = ms["a rig, planes, a fifth moves"] / ms["a rig, planes, all of it moves"]
        checks = [
            Check("a step on a rig", ms["a rig, lives"], RIG_BAR, unit="ms"),
            Check("a step of which a fifth moves, over one of which all does", share, HALF),
        ]
    else:
        checks = [Check("a step on control nodes", ms["control nodes"], NODES_BAR, unit="ms")]
    count = bench.count(RIG_COUNT if rig else NODES_COUNT, 200)
    return Measured(
        protocol=f"{name}, {count:,} Gaussians, {views.width}x{views.height}; mean of {PERIOD} steps; {torch.get_num_threads()} threads",
        checks=checks,
        numbers={"times": {what: t.json() for what, t in times.items()}},
        columns=("", "best ms a step", "median ms a step", "runs"),
        table=[(what, f"{ms[what]:.1f}", f"{1e3 * t.median / PERIOD:.1f}", str(len(t.runs))) for what, t in times.items()],
    )


def _model(bench: Bench, views: Views, masks: list[np.ndarray] | None, motion: str, moving: float = 1.0) -> Model:
    model = make_model(bench, views, masks, NODES_COUNT if motion == "nodes" else RIG_COUNT)
    gaussians = model.gaussians
    if motion == "nodes":
        model.field = make_nodes(gaussians.means.detach().numpy(), TrainingSettings.model_validate({}))
    elif motion == "free":
        model.field = FreeMotion(len(np.unique(views.time)))
        gaussians.live(0.5 * (model.field.times - 1), model.field.times)
    gaussians.dynamic = torch.arange(len(gaussians)) < moving * len(gaussians)
    return model


def _steps(model: Model, views: Views) -> Callable[[], None]:
    """`PERIOD` steps of all that a step is, without density control and checkpoints between steps."""
    phase, settings = Phase("deformation", STEPS), TrainingSettings.model_validate({})
    assert model.field is not None
    recipe = RECIPES[str(model.field.config["kind"])]
    trainer = Trainer(model, views, [phase], settings, budget=len(model.gaussians), grow=False, recipe=recipe)
    trainer.iteration = BEGUN

    def steps() -> None:
        for _ in range(PERIOD):
            trainer._step(phase, trainer.iteration)
            trainer.iteration += 1

    return steps
