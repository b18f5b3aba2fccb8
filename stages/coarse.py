"""`coarse`: Gaussians learn the scene's shape and motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from ..pipeline import Applies, Context, Resources, Stage
from ..scene.settings import Strategy, TrainingSettings
from .seeding.seeds import is_rig

if TYPE_CHECKING:
    import numpy as np

    from ..scene.views import Views

SMALL_IMAGE = 40_000  # px; halves of smaller images show too little
ITERATIONS = 6000
ITERATIONS_A_TIME = 200  # of a rig: each time has its own
MOST_ITERATIONS = 30_000
LEAST_ITERATIONS = 2000  # fewer show fog
ITERATIONS_NODES = 40_000
NODES = 512
NODE_SEEDS = 2500  # few seeds that multiply where the error is come out better than many
NODE_TIMES = 9  # fewer say too little about motion


class CoarseSettings(TrainingSettings):
    iterations: int = Field(0, ge=0, le=1_000_000, description="optimiser steps of this stage; 0 chooses by the capture")
    effort: float = Field(1.0, gt=0, le=100, description="factor on the steps that are chosen by the capture")
    motion: Literal["auto", "planes", "nodes", "free"] = Field(
        "auto",
        description="what moves primitives: the six-plane field; control nodes (auto: where each frame is from another side); each one "
        "itself, for a while (auto: where masks show what moves)",
    )
    strategy: Strategy = Field("two-stage", description="one of the four trainings of Table 3; `fine` follows it")
    full_from: float = Field(0.75, ge=0, le=1, description="fraction of the steps on images of half the size, before those of full size")
    seeds: int = Field(0, ge=0, le=2_000_000, description="Gaussians to begin with; 0 chooses: half the budget for rigs, else 8000")


class Coarse(Stage):
    """Seeds, static warm-up, deformation; writes a model without convexes."""

    name = "coarse"
    inputs = ("frames", "poses", "flow")
    settings = CoarseSettings
    reads_capture = True
    device_class = True

    def applies(self, facts: Mapping[str, Any], settings: CoarseSettings) -> Applies:
        if facts.get("static"):
            return Applies.yes("nothing moves: Gaussians without a deformation field")
        if use_nodes(facts, settings):
            return Applies.yes("Gaussians, moved by control nodes")
        if settings.motion == "free" or (settings.motion == "auto" and facts.get("pairs", 0)):
            return Applies.yes("Gaussians; what masks show to move lives around a time of its own")
        return Applies.yes("Gaussians, moved by the six-plane field")

    def estimate(self, facts: Mapping[str, Any], settings: CoarseSettings) -> float | None:
        from .estimates import node_training_seconds, training_seconds

        static = bool(facts.get("static"))
        steps = settings.iterations or auto_iterations(facts, settings)
        if use_nodes(facts, settings):
            return node_training_seconds(facts, steps)
        return training_seconds(facts, steps, static, area=1 - 0.75 * settings.full_from)

    def resources(self, facts: Mapping[str, Any], settings: CoarseSettings, device: str) -> Resources:
        from .estimates import training_resources

        return training_resources(facts, device)

    def run(self, ctx: Context) -> None:
        import numpy as np
        import torch

        from ..scene.model import Model
        from ..scene.motion.free import FreeMotion
        from ..scene.primitives import ConvexSet, GaussianSet
        from ..scene.seeds.near_plane import near_plane
        from ..scene.training.recipe import RECIPES
        from ..scene.training.schedule import HALF_RESOLUTION, coarse_phases, node_phases
        from ..scene.training.trainer import Trainer
        from ..vision.images.png import encode_png
        from .artifacts.dataset import load_frameset, load_views, measured_flow
        from .artifacts.training import write_depth, write_training
        from .seeding.fill import measured_depth
        from .seeding.picture import seeds_picture
        from .seeding.seeds import initial_dynamic, living, load_seeds, mover_seeds

        settings = ctx.settings
        torch.manual_seed(settings.seed)
        frames = load_frameset(ctx.inputs, ctx.capture.root)
        views = load_views(frames, ctx.inputs["flow"], ctx.device)
        static = is_static(ctx)

        nodes = not static and use_nodes(ctx.facts, settings)
        budget = settings.budget or auto_budget(ctx.facts, views, nodes)
        seeds = settings.seeds or auto_seeds(ctx.facts, budget)
        points, colors, trusted, inverse_depth = load_seeds(ctx, frames, views, seeds)
        movers = None if static or nodes else mover_seeds(ctx, frames, views, points, budget // 2)
        free = settings.motion == "free" or (settings.motion == "auto" and movers is not None)
        views.near = near_plane(views, trusted if movers is None else np.concatenate([trusted, movers.points]))
        if frames.background is None:
            views.background = mean_colour(views)
        if nodes:
            chosen = np.random.default_rng(settings.seed).permutation(len(points))[:NODE_SEEDS]
            points, colors = points[chosen], colors[chosen]
        unit = views.viewing_distance(points)
        begin = encode_png(seeds_picture(views, points, colors, movers))
        dynamic = np.zeros(len(points), bool) if static else initial_dynamic(ctx, points, views, movers is not None)
        if movers is not None and not free:  # at rest is where it is at the middle time
            middle = movers.time == movers.time[np.abs(movers.time - 0.5).argmin()]
            points, colors = np.concatenate([points, movers.points[middle]]), np.concatenate([colors, movers.colors[middle]])
            dynamic = np.concatenate([dynamic, np.ones(int(middle.sum()), bool)])
        sh_degree = auto_sh_degree(ctx.facts) if settings.sh_degree is None else settings.sh_degree
        gaussians = GaussianSet.from_points(points, colors, sh_degree, max_scale=0.05 * unit)
        field: Any = None
        if not static:
            gaussians.dynamic = torch.from_numpy(dynamic)
            if free:
                field = FreeMotion(len(np.unique(views.time)))
                gaussians.live(0.5 * (field.times - 1), field.times)
                if movers is not None:
                    gaussians = GaussianSet.joined([gaussians, *living(movers, field, sh_degree, 0.05 * unit)])
            elif nodes:
                field = make_nodes(points, settings)
            else:
                field = make_field(points[dynamic] if dynamic.sum() >= 50 else points, views, settings)
            field.to(ctx.device)
        empty = ConvexSet.empty(6, sh_degree)
        model = Model(gaussians, empty, field, sh_degree, views.near, views.background).to(ctx.device)

        steps = settings.iterations or auto_iterations({**ctx.facts, "static": static}, settings)
        small = views.width * views.height < SMALL_IMAGE
        if nodes and settings.strategy in ("two-stage", "alternating"):
            phases = node_phases(steps, 1.0 if small else HALF_RESOLUTION)
        else:
            phases = coarse_phases(settings.strategy, steps, static, 0.0 if small else settings.full_from, not free)
        total = sum(phase.iterations for phase in phases)
        with ctx.progress(total, "coarse") as bar:
            trainer = Trainer(
                model,
                views,
                phases,
                settings,
                budget=budget,
                checkpoints=ctx.checkpoints,
                measured_flow=measured_flow(ctx.inputs["flow"], views),
                measured_depth=measured_depth(inverse_depth, unit, ctx, frames),
                recipe=RECIPES["planes" if field is None else field.config["kind"]],
                advance=lambda n, note: bar.advance(n, note),
                log=ctx.log,
            )
            log = trainer.run()
        ctx.out.write("seeds_png", np.frombuffer(begin, np.uint8), doc="where training began, for the report")
        ctx.out.attrs["strategy"] = settings.strategy
        ctx.out.attrs["iterations"] = steps
        write_training(ctx.out, model, log)
        write_depth(ctx.out, inverse_depth)


def is_static(ctx: Context) -> bool:
    """Nothing moves: the user says so, or `flow` has found it."""
    flow = ctx.inputs["flow"]
    return bool(ctx.facts.get("static") or (flow is not None and flow.attrs.get("static")))


def auto_budget(facts: Mapping[str, Any], views: Views, nodes: bool) -> int:
    """One Gaussian for eight pixels of one view, 12,000 to 120,000; for five where nodes move them, whose few parameters bear
    more; for four of a rig, which sees a whole room, 40,000 to 240,000."""
    pixels = views.width * views.height
    if is_rig(facts):
        return int(min(max(pixels // 4, 40_000), 240_000))
    if nodes:
        return int(min(max(pixels // 5, 12_000), 120_000))
    return int(min(max(pixels // 8, 12_000), 120_000))


def auto_seeds(facts: Mapping[str, Any], budget: int) -> int:
    """Half the budget for rigs: what growth adds goes where some primitive is, so each wall needs some to begin with. Else 8000."""
    return budget // 2 if is_rig(facts) else 8000


def auto_sh_degree(facts: Mapping[str, Any]) -> int:
    """Few cameras of a rig see a place from few sides, and what they disagree about is not what views between them see."""
    return 1 if is_rig(facts) else 2


def mean_colour(views: Views) -> tuple[float, float, float]:
    """RGB in [0, 1] of the training views: what shows through an opaque scene's holes should not shine nor be black."""
    few = views.train[:: max(1, len(views.train) // 60)]
    means = [views.target(int(i), 0.25).double().mean((0, 1)).tolist() for i in few]
    red, green, blue = (sum(channel) / len(few) for channel in zip(*means))
    return red, green, blue


def use_nodes(facts: Mapping[str, Any], settings: CoarseSettings) -> bool:
    """Control nodes move the scene where it moves and each frame is a camera of its own: one view a time says too little for planes."""
    if facts.get("static") or settings.motion != "auto":
        return settings.motion == "nodes" and not facts.get("static")
    return facts.get("cameras", 1) == facts.get("frames", 0) and facts.get("pairs", 0) == 0 and facts.get("times", 1) >= NODE_TIMES


def auto_iterations(facts: Mapping[str, Any], settings: CoarseSettings) -> int:
    """6000 steps; for a rig, which is several cameras at one time, at least 200 a time, up to 30,000; `ITERATIONS_NODES` for control nodes;
    all of them times the effort, but never below 2000."""
    steps = ITERATIONS_NODES
    if not use_nodes(facts, settings):
        moving_rig = is_rig(facts) and not facts.get("static")
        steps = min(max(ITERATIONS, ITERATIONS_A_TIME * facts.get("times", 1) if moving_rig else 0), MOST_ITERATIONS)
    return max(round(steps * settings.effort), min(steps, LEAST_ITERATIONS))


def make_nodes(points: np.ndarray, settings: TrainingSettings):
    """Control nodes spread over ``points`` [P, 3]."""
    import numpy as np
    import torch

    from ..scene.motion.nodes import ControlNodes, farthest_points

    low, high = np.percentile(points, 1, axis=0), np.percentile(points, 99, axis=0)
    inside = points[((points >= low) & (points <= high)).all(1)]
    extent = max(0.5 * float((high - low).max()), 1e-6)
    positions = farthest_points(inside if len(inside) else points, NODES)
    return ControlNodes(torch.tensor(positions), torch.tensor(0.5 * (low + high)), extent, extent, seed=settings.seed)


def make_field(points: np.ndarray, views: Views, settings: TrainingSettings):
    """A field over the box of ``points``, widened by a fifth; outliers beyond the 1st and 99th percentile do not stretch it."""
    import numpy as np
    import torch

    from ..scene.motion.field import DeformationField

    low, high = np.percentile(points, 1, axis=0), np.percentile(points, 99, axis=0)
    margin = 0.2 * (high - low).max()
    times = len(np.unique(views.time))
    return DeformationField(torch.tensor(low - margin), torch.tensor(high + margin), times, seed=settings.seed)
