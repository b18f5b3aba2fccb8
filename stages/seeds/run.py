"""The work of `seeds`: finds places where Gaussians begin, and what else of them is known before training."""

from __future__ import annotations

import numpy as np

from ...pipeline import Context
from ...scene.motion.kinds import choose, motion_class
from ...scene.seeds.colours import mean_colour
from ...scene.seeds.near_plane import near_plane
from ...scene.seeds.path_width import path_width
from ...scene.seeds.picture import seeds_picture
from ...vision.images.png import encode_png
from ..shared.dataset import load_frameset, load_views
from ..shared.defaults import auto_budget, found_facts, one_way
from .artifact import StoredSeeds
from .defaults import auto_seeds
from .place import initial_dynamic, load_seeds, moving_seeds


def place_seeds(ctx: Context) -> None:
    """Places seeds on what is static and on what moves, and writes them with what follows from them for all views."""
    settings = ctx.settings
    frames = load_frameset(ctx.inputs, ctx.capture.root)
    views = load_views(frames, ctx.inputs["flow"])
    facts = found_facts(ctx, views)
    motion = motion_class(choose(settings.motion, facts))
    budget = settings.budget or auto_budget(facts, views, motion.kind)
    count = settings.count or auto_seeds(facts, budget)
    found = load_seeds(ctx, frames, views, count, fill=one_way(facts))
    points, colors, trusted = found.points, found.colors, found.trusted
    moving = moving_seeds(ctx, frames, views, found, budget // 2) if motion.moving_seeds else None
    views.near = near_plane(views, trusted if moving is None else np.concatenate([trusted, moving.points]))
    if frames.background is None:
        views.background = mean_colour(views)
    if motion.most_seeds is not None:
        points, colors = drawn(points, colors, motion.most_seeds, settings.seed)
    room = len(points) if settings.budget is None else budget - (0 if moving is None else len(moving.points))
    if len(points) > room:  # a budget that was asked for holds from the start
        points, colors = drawn(points, colors, room, settings.seed)
        ctx.log(f"seeds: {len(points)} of them are used, since train.budget is {budget}")
    seeds = StoredSeeds(
        points=points,
        colors=colors,
        dynamic=np.zeros(len(points), bool) if facts.static else initial_dynamic(ctx, points, views, moving is not None),
        moving=moving,
        depth=found.inverse_depth,
        near=float(views.near),
        background=views.background,
        path_width=path_width(views, trusted) if one_way(facts) else None,
    )
    seeds.write(ctx.out, encode_png(seeds_picture(views, points, colors, moving)))


def drawn(points: np.ndarray, colors: np.ndarray, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """``count`` of the ``points`` [N, 3] at random, with their ``colors`` [N, 3]: all if there are fewer, none if ``count`` is negative."""
    chosen = np.random.default_rng(seed).permutation(len(points))[: max(count, 0)]
    return points[chosen], colors[chosen]
