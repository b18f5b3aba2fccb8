"""The work of `coarse`: turns seeds into Gaussians and trains them to represent the scene's shape and motion."""

from __future__ import annotations

import torch

from ...pipeline import Context
from ...scene.model import Model
from ...scene.motion.kinds import KINDS, choose, motion_class
from ...scene.motion.start import Start
from ...scene.primitives import ConvexSet
from ...scene.settings import GrowthSettings
from ...scene.views import Views
from ..facts import Facts
from ..seeds.artifact import StoredSeeds, required
from ..shared.clocks import clock_lines
from ..shared.dataset import load_frameset, load_views
from ..shared.defaults import auto_budget, found_facts
from ..shared.measured import load_measured
from ..shared.model import write_model
from ..shared.train import train
from ..shared.training_log import write_training_log
from .artifact import StoredCoarse
from .defaults import auto_iterations, auto_sh_degree
from .first_motion import find_first_motion
from .settings import CoarseSettings

SMALL_IMAGE = 40_000  # px; smaller images show too little at half size
MOST_SCALE = 0.05  # of the viewing distance, largest initial standard deviation of a Gaussian


def train_coarse(ctx: Context) -> None:
    """Trains a static warm-up and then the deformation, from the places where `seeds` begins, and writes a model without convexes."""
    settings = ctx.settings
    torch.manual_seed(settings.seed)
    frames = load_frameset(ctx.inputs, ctx.capture.root)
    views = load_views(frames, ctx.inputs["flow"], ctx.device)
    seeds = StoredSeeds.read(required(ctx.inputs["seeds"]))
    views.near, views.background = seeds.near, seeds.background
    facts = found_facts(ctx, views)

    expected, kind = choose(settings.motion, facts), choose(settings.motion, facts, seeds.moving is not None)
    if kind != expected:
        ctx.log(f"{'no seeds' if seeds.moving is None else 'seeds'} were found on moving objects: {KINDS[kind].moves}")
    unit, small = views.viewing_distance(seeds.points), is_small(views)
    sh_degree = chosen_sh_degree(ctx, facts, seeds.path_width) if settings.sh_degree is None else settings.sh_degree
    steps = settings.iterations or auto_iterations(facts, settings, ctx.device)
    budget = settings.budget or auto_budget(facts, views, expected)

    start = Start(seeds.points, seeds.colors, seeds.dynamic, seeds.moving, sh_degree, MOST_SCALE * unit)
    model = first_model(kind, start, views, settings).to(ctx.device)
    phases = model.motion.phases(settings.strategy, steps, settings.full_from, small)
    measured = load_measured(ctx, frames, views, seeds.depth, unit, model.motion.splits_in_time)
    find_first_motion(ctx, model, views, settings, steps, small)
    log = train(
        ctx,
        "coarse",
        model,
        views,
        phases,
        settings,
        budget=budget,
        most=settings.budget,
        measured=measured,
    )
    for line in clock_lines(model.clocks, frames):
        ctx.log(line)
    if not len(model.gaussians):
        ctx.log("no Gaussian is left, so the model shows its background alone: do the pictures show anything, and are the poses right?")
    growth = GrowthSettings(**settings.model_dump(include=set(GrowthSettings.model_fields)))
    StoredCoarse(settings.strategy, steps, growth).write(ctx.out)
    write_model(ctx.out, model)
    write_training_log(ctx.out, log)


def chosen_sh_degree(ctx: Context, facts: Facts, width: float | None) -> int:
    """`auto_sh_degree`, with the ``width`` of the path, where it matters."""
    degree = auto_sh_degree(facts, width or 0.0)
    if width is not None:
        ctx.log(f"SH degree {degree}: the training frames show a point from directions that differ by {width:.0f} degrees at most")
    return degree


def first_model(kind: str, start: Start, views: Views, settings: CoarseSettings) -> Model:
    """The initial model: Gaussians on the seeds, and what moves them."""
    motion, gaussians = motion_class(kind).start(start, views, settings)
    empty = ConvexSet.empty(6, start.sh_degree)
    return Model(gaussians, empty, motion, start.sh_degree, views.near, views.background, antialiased=settings.antialiased)


def is_small(views: Views) -> bool:
    """Whether images of half the size show too little."""
    return views.width * views.height < SMALL_IMAGE
