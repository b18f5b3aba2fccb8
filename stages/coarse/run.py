"""The work of `coarse`: turns seeds into Gaussians and trains them to represent the scene's shape and motion."""

from __future__ import annotations

import numpy as np
import torch

from ...pipeline import Context
from ...scene.model import Model
from ...scene.motion.kinds import KINDS, choose, motion_class
from ...scene.motion.start import Start
from ...scene.primitives import ConvexSet
from ...scene.seeds.near_plane import near_plane
from ...scene.settings import GrowthSettings
from ...scene.views import Views
from ...vision.images.png import encode_png
from ..facts import Facts
from ..seeds.defaults import auto_seeds
from ..seeds.fill import measured_depth, moving_pixels
from ..seeds.picture import seeds_picture
from ..seeds.place import initial_dynamic, load_seeds, moving_seeds
from ..shared.dataset import load_frameset, load_views, measured_flow
from ..shared.defaults import auto_budget, found_facts, one_way
from ..shared.model import write_model
from ..shared.train import train
from ..shared.training_log import write_training_log
from .artifact import StoredCoarse
from .defaults import auto_iterations, auto_sh_degree
from .first_motion import find_first_motion
from .path_width import path_width
from .settings import CoarseSettings

SMALL_IMAGE = 40_000  # px; smaller images show too little at half size
MOST_SCALE = 0.05  # of the viewing distance, largest initial standard deviation of a Gaussian


def train_coarse(ctx: Context) -> None:
    """Places seeds, trains a static warm-up and then the deformation, and writes a model without convexes."""
    settings = ctx.settings
    torch.manual_seed(settings.seed)
    frames = load_frameset(ctx.inputs, ctx.capture.root)
    views = load_views(frames, ctx.inputs["flow"], ctx.device)
    facts = found_facts(ctx, views)
    expected = motion_class(choose(settings.motion, facts))
    budget = settings.budget or auto_budget(facts, views, expected.kind)
    count = settings.seeds or auto_seeds(facts, budget)
    points, colors, trusted, inverse_depth = load_seeds(ctx, frames, views, count, fill=one_way(facts))
    moving = moving_seeds(ctx, frames, views, points, budget // 2) if expected.moving_seeds else None
    views.near = near_plane(views, trusted if moving is None else np.concatenate([trusted, moving.points]))
    if frames.background is None:
        views.background = mean_colour(views)
    if expected.most_seeds is not None:
        chosen = np.random.default_rng(settings.seed).permutation(len(points))[: expected.most_seeds]
        points, colors = points[chosen], colors[chosen]
    unit = views.viewing_distance(points)
    begin = encode_png(seeds_picture(views, points, colors, moving))
    dynamic = np.zeros(len(points), bool) if facts.static else initial_dynamic(ctx, points, views, moving is not None)
    kind = choose(settings.motion, facts, moving is not None)
    if kind != expected.kind:
        found = "no seeds were" if moving is None else "seeds were"
        ctx.log(f"{found} found on moving objects: {KINDS[kind].moves}")
    sh_degree = chosen_sh_degree(ctx, facts, views, trusted) if settings.sh_degree is None else settings.sh_degree
    start = Start(points, colors, dynamic, moving, sh_degree, MOST_SCALE * unit)
    model = first_model(kind, start, views, settings).to(ctx.device)

    steps = settings.iterations or auto_iterations(facts, settings, ctx.device)
    find_first_motion(ctx, model, views, settings, steps, is_small(views))
    log = train(
        ctx,
        "coarse",
        model,
        views,
        model.motion.phases(settings.strategy, steps, settings.full_from, is_small(views)),
        settings,
        budget=budget,
        measured_flow=measured_flow(ctx.inputs["flow"], views),
        measured_depth=measured_depth(inverse_depth, unit, ctx, frames),
        moving=moving_pixels(ctx, frames, views) if model.motion.splits_in_time else None,
    )
    if not len(model.gaussians):
        ctx.log("no Gaussian is left, so the model shows its background alone: do the pictures show anything, and are the poses right?")
    growth = GrowthSettings(**settings.model_dump(include=set(GrowthSettings.model_fields)))
    StoredCoarse(settings.strategy, steps, inverse_depth, growth).write(ctx.out, begin)
    write_model(ctx.out, model)
    write_training_log(ctx.out, log)


def chosen_sh_degree(ctx: Context, facts: Facts, views: Views, points: np.ndarray) -> int:
    """`auto_sh_degree`, with the width of the path as the trusted ``points`` [P, 3] see it, where it matters."""
    width = path_width(views, points) if one_way(facts) else 0.0
    degree = auto_sh_degree(facts, width)
    if one_way(facts):
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


def mean_colour(views: Views) -> tuple[float, float, float]:
    """Mean RGB in [0, 1] of the training views. As the background it keeps holes in an opaque scene from looking bright or black."""
    few = views.train[:: max(1, len(views.train) // 60)]
    means = [views.target(int(i), 0.25).double().mean((0, 1)).tolist() for i in few]
    red, green, blue = (sum(channel) / len(few) for channel in zip(*means))
    return red, green, blue
