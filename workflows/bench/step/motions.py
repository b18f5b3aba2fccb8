"""Times a training step with the motion that a capture gets: control nodes for one camera at a time; for a rig, with all or a fifth of the
scene in motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from ....scene.model import Model
from ....scene.motion.lifetimes.lifetime import set_lifetime
from ....scene.motion.lifetimes.lifetimes import Lifetimes
from ....scene.motion.nodes.control_nodes import ControlNodes
from ....scene.views import Views
from ..rows import Bench, Check, Measured
from ..timing import interleaved
from .training import PERIOD, make_model, make_trainer, views_of

NODES_COUNT, RIG_COUNT = 40_000, 60_000
NODES_BAR, RIG_BAR = 30.0, 80.0  # ms per step on two cores, at 400x400 and 640x360
MOVING = 0.2  # share of the rig's Gaussians, and of its pictures, that move in the row where most is static
HALF = 0.5  # bar: share of the time of a step in which everything moves
NODES = {"control nodes": ("nodes", 1.0)}
RIG = {"a rig, all of it moves": ("lifetimes", 1.0), "a rig, a fifth moves": ("lifetimes", MOVING)}


def measure(bench: Bench) -> Measured:
    views, masks, name = views_of(bench)
    rig = is_rig(views)
    kinds = RIG if rig else NODES
    models = {what: model_in_motion(bench, views, masks, *kind) for what, kind in kinds.items()}
    times = interleaved(bench, {what: make_trainer(model, _views(views, kinds[what][1]))[1] for what, model in models.items()})
    ms = {what: 1e3 * t.best / PERIOD for what, t in times.items()}
    if rig:
        share = ms["a rig, a fifth moves"] / ms["a rig, all of it moves"]
        checks = [
            Check("a step on a rig", ms["a rig, all of it moves"], RIG_BAR, unit="ms"),
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


def _views(views: Views, moving: float) -> Views:
    """``views`` in which a band of this share of each picture moves, at a place that depends on the frame."""
    if moving == 1.0:
        return views

    def band(i: int) -> np.ndarray:
        mask = np.zeros((views.height, views.width), np.uint8)
        width = round(moving * views.width)
        first = i * width // 4 % (views.width - width)
        mask[:, first : first + width] = 255
        return mask

    return replace(views, load_moving=band)


def is_rig(views: Views) -> bool:
    """Whether several cameras see the same times."""
    return len(np.unique(views.camera)) > 1 and len(np.unique(views.time)) < len(views.train)


def model_in_motion(bench: Bench, views: Views, masks: list[np.ndarray] | None, motion: str, moving: float) -> Model:
    """A model whose ``motion`` is "nodes" or "lifetimes", of which the share ``moving`` is dynamic."""
    model = make_model(bench, views, masks, NODES_COUNT if motion == "nodes" else RIG_COUNT)
    if motion == "nodes":
        model.motion = ControlNodes.over(model.gaussians.means.detach().numpy())
    elif motion == "lifetimes":
        times = len(np.unique(views.time))
        model.motion = Lifetimes(times)
        set_lifetime(model.gaussians, 0.5 * (times - 1), times)
    gaussians = model.gaussians
    gaussians.dynamic = torch.arange(len(gaussians)) < moving * len(gaussians)
    return model
