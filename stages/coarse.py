"""`coarse`: Gaussians learn the scene's shape and motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

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


class CoarseSettings(TrainingSettings):
    iterations: int = Field(0, ge=0, le=1_000_000, description="optimiser steps of this stage; 0 chooses by the capture")
    strategy: Strategy = Field("two-stage", description="one of the four trainings of Table 3; `fine` follows it")
    full_from: float = Field(0.75, ge=0, le=1, description="fraction of the steps on images of half the size, before those of full size")
    seeds: int = Field(8000, ge=100, le=2_000_000, description="Gaussians to begin with where the capture brings no points")


class Coarse(Stage):
    """Seeds, static warm-up, deformation; writes a model without convexes."""

    name = "coarse"
    version = 2
    inputs = ("frames", "poses", "flow")
    settings = CoarseSettings
    reads_capture = True
    device_class = True

    def applies(self, facts: Mapping[str, Any], settings: CoarseSettings) -> Applies:
        if facts.get("static"):
            return Applies.yes("nothing moves: Gaussians without a deformation field")
        return Applies.yes("Gaussians and their motion")

    def estimate(self, facts: Mapping[str, Any], settings: CoarseSettings) -> float | None:
        from .estimates import training_seconds

        static = bool(facts.get("static"))
        steps = settings.iterations or auto_iterations(facts.get("frames", 0), facts.get("times", 1), static)
        half = settings.full_from * 0.5  # a step on images of half the size takes about half as long: the field does not shrink
        return (1 - half) * training_seconds(facts, steps, static)

    def run(self, ctx: Context) -> None:
        import torch

        from ..scene.model import Model
        from ..scene.primitives import ConvexSet, GaussianSet
        from ..scene.schedule import coarse_phases
        from ..scene.trainer import Trainer
        from .dataset import load_frameset, load_views, measured_flow
        from .training_artifact import write_training

        settings = ctx.settings
        torch.manual_seed(settings.seed)
        frames = load_frameset(ctx.inputs, ctx.capture.root)
        views = load_views(frames, ctx.inputs["flow"])
        static = bool(ctx.facts.get("static"))

        points, colors = load_seeds(ctx, frames, views)
        gaussians = GaussianSet.from_points(points, colors, settings.sh_degree, max_scale=0.05 * views.viewing_distance(points))
        field = None
        if not static:
            gaussians.dynamic = initial_dynamic(ctx, points, views)
            moving = gaussians.dynamic.numpy()
            field = make_field(points[moving] if moving.sum() >= 50 else points, views, settings)
        model = Model(gaussians, ConvexSet.empty(6, settings.sh_degree), field, settings.sh_degree)

        small = views.width * views.height < SMALL_IMAGE
        steps = settings.iterations or auto_iterations(ctx.facts["frames"], ctx.facts["times"], static)
        phases = coarse_phases(settings.strategy, steps, static, 0.0 if small else settings.full_from)
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


def auto_budget(views: Views) -> int:
    """One Gaussian for eight pixels of one view; 12,000 to 120,000. On a rendered rig of six cameras 12,000 and 32,000 came out equal on a
    held-out one (20.87 and 20.88 dB)."""
    return int(min(max(views.width * views.height // 8, 12_000), 120_000))


def auto_iterations(frames: int, times: int, static: bool) -> int:
    """6000 steps; for a rig, which is several cameras at one time, at least 200 a time, up to 30,000."""
    from ..scene.curriculum import MIN_CAMERAS

    rig = not static and frames >= MIN_CAMERAS * times
    return min(max(ITERATIONS, ITERATIONS_A_TIME * times if rig else 0), MOST_ITERATIONS)


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
