"""The work of `fine`: convexes take the place of the Gaussians that `hulls` chose, and both are refined."""

from __future__ import annotations

import torch

from ...pipeline import Context
from ...scene.model import Model
from ...scene.motion.kinds import KINDS
from ...scene.motion.phases import fine_phases, left_to_fine
from ...scene.primitives import ConvexSet
from ...scene.settings import GrowthSettings, RefinementSettings, TrainingSettings
from ..coarse.artifact import StoredCoarse, required
from ..hulls.artifact import StoredHulls
from ..seeds.artifact import read_depth
from ..shared.dataset import load_frameset, load_views
from ..shared.defaults import auto_budget, found_facts
from ..shared.measured import load_measured
from ..shared.model import read_model, write_model
from ..shared.train import train
from ..shared.training_log import write_training_log
from .defaults import auto_lr_scale, fine_iterations
from .settings import FineSettings


def train_fine(ctx: Context) -> None:
    """Refines the model of `coarse` together with the convexes of `hulls`."""
    settings = ctx.settings
    torch.manual_seed(settings.seed)
    artifact = required(ctx.inputs["coarse"])
    coarse, model = StoredCoarse.read(artifact), read_model(artifact)
    frames = load_frameset(ctx.inputs, ctx.capture.root)
    views = load_views(frames, ctx.inputs["flow"], ctx.device, model)
    hulls = None if ctx.inputs["hulls"] is None else StoredHulls.read(ctx.inputs["hulls"])
    joint = coarse.strategy == "joint"
    if hulls is not None and len(hulls):
        replace_by_convexes(model, hulls)
    elif not KINDS[model.motion.kind].convexes and not joint and settings.iterations is None:
        ctx.log("no convexes: the model of `coarse` is kept, which has been refined to its end")
        write_model(ctx.out, model)
        return
    else:
        ctx.log("no convexes: Gaussians alone are refined")
    model.to(ctx.device)

    facts, unit = found_facts(ctx, views), views.viewing_distance(model.gaussians.means.detach().cpu().numpy())
    log = train(
        ctx,
        "fine",
        model,
        views,
        fine_phases(coarse.strategy, coarse.iterations, fine_iterations(settings, facts, ctx.device), facts.static),
        training_settings(settings, coarse.growth),
        budget=coarse.growth.budget or auto_budget(facts, views, model.motion.kind),
        most=None if coarse.growth.budget is None else max(0, coarse.growth.budget - len(model.convexes)),
        earlier=coarse.iterations - left_to_fine(coarse.strategy, coarse.iterations, facts.static),
        lr_scale=1.0 if joint else auto_lr_scale(settings, facts),
        grow=joint,
        measured=load_measured(ctx, frames, views, read_depth(ctx.inputs["seeds"]), unit, moving=joint),
    )
    write_model(ctx.out, model)
    write_training_log(ctx.out, log)


def training_settings(settings: FineSettings, growth: GrowthSettings) -> TrainingSettings:
    """Settings for the trainer. Growth, if enabled, uses the settings of `coarse`."""
    return TrainingSettings(**settings.model_dump(include=set(RefinementSettings.model_fields)), **growth.model_dump())


def replace_by_convexes(model: Model, hulls: StoredHulls) -> None:
    """Each convex takes the place of the Gaussian that it came from, with its colours, opacity and attributes."""
    seeds = torch.from_numpy(hulls.seed).long()
    rest = torch.ones(len(model.gaussians), dtype=torch.bool)
    rest[seeds] = False
    model.convexes = ConvexSet.replacing(model.gaussians.select(seeds), hulls.k)
    model.gaussians = model.gaussians.select(rest.nonzero()[:, 0])
