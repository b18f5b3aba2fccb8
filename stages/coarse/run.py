"""The work of `coarse`: turns seeds into Gaussians and trains them to represent the scene's shape and motion."""

from __future__ import annotations

from typing import Literal

import numpy as np
import torch

from ...pipeline import Context
from ...scene.model import Model
from ...scene.motion.field import DeformationField
from ...scene.motion.free import FreeMotion
from ...scene.motion.nodes import ControlNodes
from ...scene.primitives import ConvexSet, GaussianSet
from ...scene.settings import GrowthSettings
from ...scene.training.schedule import HALF_RESOLUTION, Phase, coarse_phases, node_phases
from ...scene.views import Views
from ..facts import Facts
from ..seeds.artifact import StoredSeeds, required
from ..shared.dataset import load_frameset, load_views, measured_flow
from ..shared.defaults import auto_budget, found_facts, use_nodes
from ..shared.masks import measured_depth, moving_pixels
from ..shared.model import write_model
from ..shared.train import train
from ..shared.training_log import write_training_log
from .artifact import StoredCoarse
from .defaults import BY_NODE_PHASES, auto_iterations, auto_sh_degree
from .first_motion import find_first_motion
from .motions import living, make_field, make_nodes
from .settings import CoarseSettings

SMALL_IMAGE = 40_000  # px; smaller images show too little at half size
MOST_SCALE = 0.05  # of the viewing distance, largest initial standard deviation of a Gaussian
LEAST_DYNAMIC = 50  # dynamic seeds, from which on the field spans only these

Kind = Literal["static", "planes", "nodes", "free"]


def train_coarse(ctx: Context) -> None:
    """Trains a static warm-up and then the deformation, from the places where `seeds` begins, and writes a model without convexes."""
    settings = ctx.settings
    torch.manual_seed(settings.seed)
    frames = load_frameset(ctx.inputs, ctx.capture.root)
    views = load_views(frames, ctx.inputs["flow"], ctx.device)
    seeds = StoredSeeds.read(required(ctx.inputs["seeds"]))
    views.near, views.background = seeds.near, seeds.background
    facts = found_facts(ctx, views)
    kind = kind_of_motion(facts, settings, seeds)
    unit = views.viewing_distance(seeds.points)
    sh_degree = chosen_sh_degree(ctx, facts, seeds.path_width) if settings.sh_degree is None else settings.sh_degree
    model = first_model(kind, seeds, MOST_SCALE * unit, views, sh_degree, settings).to(ctx.device)

    steps = settings.iterations or auto_iterations(facts, settings, ctx.device)
    if kind == "nodes" and settings.strategy in BY_NODE_PHASES:
        find_first_motion(ctx, model, views, settings, steps, is_small(views))
    log = train(
        ctx,
        "coarse",
        model,
        views,
        phases(kind, steps, views, settings),
        settings,
        budget=settings.budget or auto_budget(facts, views, kind == "nodes"),
        measured_flow=measured_flow(ctx.inputs["flow"], views),
        measured_depth=measured_depth(seeds.depth, unit, ctx, frames),
        moving=moving_pixels(ctx, frames, views) if kind == "free" else None,
    )
    if not len(model.gaussians):
        ctx.log("no Gaussian is left, so the model shows its background alone: do the pictures show anything, and are the poses right?")
    growth = GrowthSettings(**settings.model_dump(include=set(GrowthSettings.model_fields)))
    StoredCoarse(settings.strategy, steps, growth).write(ctx.out)
    write_model(ctx.out, model)
    write_training_log(ctx.out, log)


def kind_of_motion(facts: Facts, settings: CoarseSettings, seeds: StoredSeeds) -> Kind:
    """What moves the scene, once it is known whether anything does and whether masks show it."""
    if facts.static:
        return "static"
    if use_nodes(facts, settings.motion):
        return "nodes"
    return "free" if settings.motion == "free" or (settings.motion == "auto" and seeds.moving is not None) else "planes"


def chosen_sh_degree(ctx: Context, facts: Facts, width: float | None) -> int:
    """`auto_sh_degree`, with the ``width`` of the path, where it matters."""
    degree = auto_sh_degree(facts, width or 0.0)
    if width is not None:
        ctx.log(f"SH degree {degree}: the training frames show a point from directions that differ by {width:.0f} degrees at most")
    return degree


def first_model(kind: Kind, seeds: StoredSeeds, max_scale: float, views: Views, sh_degree: int, settings: CoarseSettings) -> Model:
    """The initial model: Gaussians on the seeds, and the motion model. max_scale: largest initial standard deviation, world units."""
    points, colors, dynamic, moving = seeds.points, seeds.colors, seeds.dynamic, seeds.moving
    if moving is not None and kind != "free":  # the rest pose is the position at the middle time
        middle = moving.time == moving.time[np.abs(moving.time - 0.5).argmin()]
        points, colors = np.concatenate([points, moving.points[middle]]), np.concatenate([colors, moving.colors[middle]])
        dynamic = np.concatenate([dynamic, np.ones(int(middle.sum()), bool)])
    gaussians = GaussianSet.from_points(points, colors, sh_degree, max_scale=max_scale)
    field: DeformationField | ControlNodes | FreeMotion | None = None
    if kind != "static":
        gaussians.dynamic = torch.from_numpy(dynamic)
    if kind == "free":
        field = FreeMotion(len(np.unique(views.time)))
        gaussians.live(0.5 * (field.times - 1), field.times)
        if moving is not None:
            gaussians = GaussianSet.joined([gaussians, *living(moving, field, sh_degree, max_scale)])
    elif kind == "nodes":
        field = make_nodes(points, settings)
    elif kind == "planes":
        field = make_field(points[dynamic] if dynamic.sum() >= LEAST_DYNAMIC else points, views, settings)
    empty = ConvexSet.empty(6, sh_degree)
    return Model(gaussians, empty, field, sh_degree, views.near, views.background, antialiased=settings.antialiased)


def phases(kind: Kind, steps: int, views: Views, settings: CoarseSettings) -> list[Phase]:
    """The training schedule. Half-size images come first if they show enough."""
    if kind == "nodes" and settings.strategy in BY_NODE_PHASES:
        return node_phases(steps, 1.0 if is_small(views) else HALF_RESOLUTION)
    full_from = 0.0 if is_small(views) else settings.full_from
    return coarse_phases(settings.strategy, steps, kind == "static", full_from, kind != "free")


def is_small(views: Views) -> bool:
    """Whether images of half the size show too little."""
    return views.width * views.height < SMALL_IMAGE
