"""The work of `coarse`: turns seeds into Gaussians and trains them to represent the scene's shape and motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
import torch

from ...pipeline import Context
from ...scene.model import Model
from ...scene.motion.field import DeformationField
from ...scene.motion.free import FreeMotion
from ...scene.motion.nodes import ControlNodes
from ...scene.primitives import ConvexSet, GaussianSet
from ...scene.seeds.near_plane import near_plane
from ...scene.settings import GrowthSettings
from ...scene.training.schedule import HALF_RESOLUTION, Phase, coarse_phases, node_phases
from ...scene.views import Views
from ...vision.images.png import encode_png
from ..artifacts.coarse import StoredCoarse
from ..artifacts.dataset import load_frameset, load_views, measured_flow
from ..artifacts.model import write_model
from ..artifacts.training_log import write_training_log
from ..facts import Facts
from ..seeding.fill import measured_depth, moving_pixels
from ..seeding.held import held_depth
from ..seeding.moving import MovingSeeds
from ..seeding.picture import seeds_picture
from ..seeding.seeds import initial_dynamic, living, load_seeds, moving_seeds
from .choices import BY_NODE_PHASES, auto_budget, auto_iterations, auto_seeds, auto_sh_degree, found_facts, one_way, use_nodes
from .first_motion import find_first_motion
from .motions import make_field, make_nodes
from .path_width import path_width
from .train import train

if TYPE_CHECKING:
    from ..coarse import CoarseSettings

SMALL_IMAGE = 40_000  # px; smaller images show too little at half size
NODE_SEEDS = 2500  # few seeds that multiply where the error is give better results than many
MOST_SCALE = 0.05  # of the viewing distance, largest initial standard deviation of a Gaussian
LEAST_DYNAMIC = 50  # dynamic seeds, from which on the field spans only these

Kind = Literal["static", "planes", "nodes", "free"]


class Start(NamedTuple):
    """Seeds of the Gaussians. points [N, 3] world units; colors [N, 3] in [0, 1]; dynamic [N] bool. moving: further seeds on moving
    objects, at several times. max_scale: largest initial standard deviation, world units."""

    points: np.ndarray
    colors: np.ndarray
    dynamic: np.ndarray
    moving: MovingSeeds | None
    max_scale: float


def train_coarse(ctx: Context) -> None:
    """Places seeds, trains a static warm-up and then the deformation, and writes a model without convexes."""
    settings = ctx.settings
    torch.manual_seed(settings.seed)
    frames = load_frameset(ctx.inputs, ctx.capture.root)
    views = load_views(frames, ctx.inputs["flow"], ctx.device)
    facts = found_facts(ctx, views)
    static, nodes = facts.static, use_nodes(facts, settings)
    budget = settings.budget or auto_budget(facts, views, nodes)
    count = settings.seeds or auto_seeds(facts, budget)
    points, colors, trusted, inverse_depth, given = load_seeds(ctx, frames, views, count, fill=one_way(facts))
    moving = None if static or nodes else moving_seeds(ctx, frames, views, points, budget // 2, given)
    held = {} if moving is None else dict(moving.held)
    views.near = near_plane(views, trusted if moving is None else np.concatenate([trusted, moving.points]))
    if frames.background is None:
        views.background = mean_colour(views)
    if nodes:
        chosen = np.random.default_rng(settings.seed).permutation(len(points))[:NODE_SEEDS]
        points, colors = points[chosen], colors[chosen]
    unit = views.viewing_distance(points)
    begin = encode_png(seeds_picture(views, points, colors, moving))
    dynamic = np.zeros(len(points), bool) if static else initial_dynamic(ctx, points, views, moving is not None)
    free = settings.motion == "free" or (settings.motion == "auto" and moving is not None)
    kind: Kind = "static" if static else "nodes" if nodes else "free" if free else "planes"
    sh_degree = chosen_sh_degree(ctx, facts, views, trusted) if settings.sh_degree is None else settings.sh_degree
    start = Start(points, colors, dynamic, moving, MOST_SCALE * unit)
    model = first_model(kind, start, views, sh_degree, settings).to(ctx.device)

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
        budget=budget,
        measured_flow=measured_flow(ctx.inputs["flow"], views),
        measured_depth=measured_depth(inverse_depth, unit, ctx, frames),
        held_depth=held_depth(held, unit, ctx, guess=given is None),
        moving=moving_pixels(ctx, frames, views) if kind == "free" else None,
    )
    if not len(model.gaussians):
        ctx.log("no Gaussian is left, so the model shows its background alone: do the pictures show anything, and are the poses right?")
    growth = GrowthSettings(**settings.model_dump(include=set(GrowthSettings.model_fields)))
    StoredCoarse(settings.strategy, steps, inverse_depth, growth, held).write(ctx.out, begin)
    write_model(ctx.out, model)
    write_training_log(ctx.out, log)


def chosen_sh_degree(ctx: Context, facts: Facts, views: Views, points: np.ndarray) -> int:
    """`auto_sh_degree`, with the width of the path as the trusted ``points`` [P, 3] see it, where it matters."""
    width = path_width(views, points) if one_way(facts) else 0.0
    degree = auto_sh_degree(facts, width)
    if one_way(facts):
        ctx.log(f"SH degree {degree}: the training frames show a point from directions that differ by {width:.0f} degrees at most")
    return degree


def first_model(kind: Kind, start: Start, views: Views, sh_degree: int, settings: CoarseSettings) -> Model:
    """The initial model: Gaussians on the seeds, and the motion model."""
    points, colors, dynamic, moving, max_scale = start
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


def mean_colour(views: Views) -> tuple[float, float, float]:
    """Mean RGB in [0, 1] of the training views. As the background it keeps holes in an opaque scene from looking bright or black."""
    few = views.train[:: max(1, len(views.train) // 60)]
    means = [views.target(int(i), 0.25).double().mean((0, 1)).tolist() for i in few]
    red, green, blue = (sum(channel) / len(few) for channel in zip(*means))
    return red, green, blue
