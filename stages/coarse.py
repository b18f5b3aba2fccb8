"""`coarse`: Gaussians learn the scene's shape and motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from ..pipeline import Applies, Context, Stage
from ..scene.settings import Strategy, TrainingSettings

if TYPE_CHECKING:
    import numpy as np

    from ..scene.views import Views
    from .frameset import FrameSet

SMALL_IMAGE = 40_000  # px; halves of smaller images show too little
ITERATIONS = 6000
ITERATIONS_A_TIME = 200  # of a rig, whose times come in one after another
MOST_ITERATIONS = 30_000
ITERATIONS_NODES = 8400  # most of them on small images
SEARCH_SECONDS = 30  # for parts that turn
NODES = 64
FRAMES_PER_KEY = 4  # while control nodes see one time after another; half as many from there on
SMALLEST_PYRAMID_IMAGE = 1500  # px


class CoarseSettings(TrainingSettings):
    iterations: int = Field(0, ge=0, le=1_000_000, description="optimiser steps of this stage; 0 chooses by the capture")
    motion: Literal["auto", "planes", "nodes"] = Field(
        "auto", description="what moves primitives: the six-plane field, or control nodes (auto: where each frame is from another side)"
    )
    strategy: Strategy = Field("two-stage", description="one of the four trainings of Table 3; `fine` follows it")
    full_from: float = Field(0.75, ge=0, le=1, description="fraction of the steps on images of half the size, before those of full size")
    seeds: int = Field(8000, ge=100, le=2_000_000, description="Gaussians to begin with where the capture brings no points")


class Coarse(Stage):
    """Seeds, static warm-up, deformation; writes a model without convexes."""

    name = "coarse"
    version = 4
    inputs = ("frames", "poses", "flow")
    settings = CoarseSettings
    reads_capture = True
    device_class = True

    def applies(self, facts: Mapping[str, Any], settings: CoarseSettings) -> Applies:
        if facts.get("static"):
            return Applies.yes("nothing moves: Gaussians without a deformation field")
        return Applies.yes(f"Gaussians and their motion by {'control nodes' if use_nodes(facts, settings) else 'the six-plane field'}")

    def estimate(self, facts: Mapping[str, Any], settings: CoarseSettings) -> float | None:
        from .estimates import training_seconds

        static = bool(facts.get("static"))
        steps = settings.iterations or auto_iterations(facts, settings)
        if use_nodes(facts, settings):
            return SEARCH_SECONDS + training_seconds(facts, steps, static, area=0.25)
        return training_seconds(facts, steps, static, area=1 - 0.75 * settings.full_from)

    def run(self, ctx: Context) -> None:
        import numpy as np
        import torch

        from ..scene.model import Model
        from ..scene.primitives import ConvexSet, GaussianSet
        from ..scene.schedule import PYRAMID, coarse_phases, pyramid_phases
        from ..scene.trainer import GAUSSIANS_PER_PIXEL, Trainer
        from .dataset import load_frameset, load_views, measured_flow
        from .training_artifact import write_training

        settings = ctx.settings
        torch.manual_seed(settings.seed)
        frames = load_frameset(ctx.inputs, ctx.capture.root)
        views = load_views(frames, ctx.inputs["flow"])
        static = is_static(ctx)

        points, colors = load_seeds(ctx, frames, views)
        pixels = views.width * views.height
        smallest = min(1.0, (SMALLEST_PYRAMID_IMAGE / pixels) ** 0.5)
        nodes = not static and use_nodes(ctx.facts, settings)
        if nodes:
            few = max(500, int(GAUSSIANS_PER_PIXEL * pixels * max(smallest, PYRAMID[0][0]) ** 2))
            chosen = np.random.default_rng(settings.seed).permutation(len(points))[:few]
            points, colors = points[chosen], colors[chosen]
        gaussians = GaussianSet.from_points(points, colors, settings.sh_degree, max_scale=0.05 * views.viewing_distance(points))
        field = None
        if not static:
            gaussians.dynamic = initial_dynamic(ctx, points, views)
            moving = gaussians.dynamic.numpy()
            make = make_nodes if nodes else make_field
            field = make(points[moving] if moving.sum() >= 50 else points, views, settings)
        model = Model(gaussians, ConvexSet.empty(6, settings.sh_degree), field, settings.sh_degree)

        steps = settings.iterations or auto_iterations({**ctx.facts, "static": static}, settings)
        if nodes and settings.strategy in ("two-stage", "alternating"):
            phases = pyramid_phases(steps, smallest)
        else:
            phases = coarse_phases(settings.strategy, steps, static, 0.0 if pixels < SMALL_IMAGE else settings.full_from)
        total = sum(phase.iterations for phase in phases)
        with ctx.progress(total, "coarse") as bar:
            trainer = Trainer(
                model,
                views,
                phases,
                settings,
                budget=settings.budget or auto_budget(views),
                checkpoints=ctx.checkpoints,
                measured_flow=measured_flow(ctx.inputs["flow"], views),
                advance=lambda n, note: bar.advance(n, note),
                log=ctx.log,
            )
            log = trainer.run()
        ctx.out.attrs["strategy"] = settings.strategy
        ctx.out.attrs["iterations"] = steps
        write_training(ctx.out, model, log)


def is_static(ctx: Context) -> bool:
    """Nothing moves: the user says so, or `flow` has found it."""
    flow = ctx.inputs["flow"]
    return bool(ctx.facts.get("static") or (flow is not None and flow.attrs.get("static")))


def auto_budget(views: Views) -> int:
    """One Gaussian for eight pixels of one view; 12,000 to 120,000. On a rendered rig of six cameras 12,000 and 32,000 came out equal on a
    held-out one (20.87 and 20.88 dB)."""
    return int(min(max(views.width * views.height // 8, 12_000), 120_000))


def use_nodes(facts: Mapping[str, Any], settings: CoarseSettings) -> bool:
    """Control nodes move the scene where it moves and each frame is a camera of its own: one view a time says too little for planes."""
    if facts.get("static") or settings.motion != "auto":
        return settings.motion == "nodes" and not facts.get("static")
    return facts.get("cameras", 1) == facts.get("frames", 0) and facts.get("pairs", 0) == 0 and facts.get("times", 1) > 2 * FRAMES_PER_KEY


def auto_iterations(facts: Mapping[str, Any], settings: CoarseSettings) -> int:
    """6000 steps; for a rig, which is several cameras at one time, at least 200 a time, up to 30,000; 8400 for control nodes."""
    from ..scene.curriculum import MIN_CAMERAS

    if use_nodes(facts, settings):
        return ITERATIONS_NODES
    frames, times = facts.get("frames", 0), facts.get("times", 1)
    rig = not facts.get("static") and frames >= MIN_CAMERAS * times
    return min(max(ITERATIONS, ITERATIONS_A_TIME * times if rig else 0), MOST_ITERATIONS)


def make_nodes(points: np.ndarray, views: Views, settings: TrainingSettings):
    """Control nodes spread over ``points``, with a key for every fourth training frame."""
    import numpy as np
    import torch

    from ..scene.nodes import ControlNodes, farthest_points

    low, high = np.percentile(points, 1, axis=0), np.percentile(points, 99, axis=0)
    inside = points[((points >= low) & (points <= high)).all(1)]
    keys = max(3, round(len(np.unique(views.time[views.train])) / FRAMES_PER_KEY))
    positions = farthest_points(inside if len(inside) else points, NODES)
    return ControlNodes(torch.tensor(positions), keys, reach=views.viewing_distance(points) / 16)


def make_field(points: np.ndarray, views: Views, settings: TrainingSettings):
    """A field over the box of ``points``, widened by a fifth; outliers beyond the 1st and 99th percentile do not stretch it."""
    import numpy as np
    import torch

    from ..scene.field import DeformationField

    low, high = np.percentile(points, 1, axis=0), np.percentile(points, 99, axis=0)
    margin = 0.2 * (high - low).max()
    times = len(np.unique(views.time))
    return DeformationField(torch.tensor(low - margin), torch.tensor(high + margin), times, seed=settings.seed)


def load_seeds(ctx: Context, frames: FrameSet, views: Views) -> tuple[np.ndarray, np.ndarray]:
    """Where Gaussians start and their colours in [0, 1]: points of the capture or SfM, else carved silhouettes, else triangulated."""
    import numpy as np

    from ..scene.seeding import carve, common_volume

    settings = ctx.settings
    if frames.points is not None and len(frames.points) >= 50:
        ctx.log(f"seeds: {len(frames.points)} points of the capture or of SfM")
        return np.asarray(frames.points), np.asarray(frames.point_colors) / 255.0
    if ctx.facts.get("alpha"):
        chosen = views.train[:: max(1, len(views.train) // 60)]
        foreground = [frames.image(int(i))[..., 3] > 127 for i in chosen]
        ctx.log(f"seeds: {settings.seeds} points inside the silhouettes of {len(chosen)} views")
        return carve(views, foreground, chosen, settings.seeds, settings.seed)

    from .sfm.triangulate import triangulate

    ctx.log("seeds: triangulating points with the known poses")
    points, colors, _ = triangulate(frames, seed=settings.seed)
    colors = colors / 255.0
    if len(points) < settings.seeds // 4:
        centre, radius = common_volume(views)
        rng = np.random.default_rng(settings.seed)
        more = centre + rng.uniform(-radius, radius, (settings.seeds, 3))
        ctx.log(f"seeds: only {len(points)} triangulated points; {len(more)} more spread over the volume that the cameras share")
        return np.concatenate([points, more]), np.concatenate([colors, np.full((len(more), 3), 0.5)])
    ctx.log(f"seeds: {len(points)} triangulated points")
    return points, colors


def initial_dynamic(ctx: Context, points: np.ndarray, views: Views):
    """[N] bool. Fixed cameras show which pixels ever change; elsewhere everything may move until the field has shown otherwise."""
    import numpy as np
    import torch

    from ..scene.dynamics import dynamic_from_masks

    flow = ctx.inputs["flow"]
    if flow is None or "moving" not in flow:
        return torch.ones(len(points), dtype=torch.bool)
    moving = flow.read("moving")
    masks = {int(camera): moving[k] for k, camera in enumerate(flow.attrs["moving_cameras"])}
    dynamic = dynamic_from_masks(points, views, masks)
    ctx.log(f"fixed cameras: {int((~dynamic).sum())} of {len(points)} seeds lie where no camera sees a change and skip the field")
    return torch.from_numpy(np.asarray(dynamic))
