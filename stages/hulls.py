"""`hulls`: where convexes begin. Fibonacci spheres at edge-dense seeds, sized by their neighbours."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import Field

from ..pipeline import Applies, Context, Resources, Settings, Stage


class HullSettings(Settings):
    k: int = Field(6, ge=3, le=8, description="points of a convex")
    budget: int = Field(2500, ge=0, le=200_000, description="most convexes; 0 does without")
    min_edge_density: float = Field(0.25, ge=0, le=1, description="mean edge weight under a seed, over the views that show it")
    radius: float = Field(1.0, gt=0, le=10, description="factor on the mean distance to the three nearest neighbours")
    views: int = Field(24, ge=1, description="training views in which edges are counted")


class Hulls(Stage):
    """Edge density is attributed to the Gaussians of `coarse` that are blended at edge pixels; the densest become seeds."""

    name = "hulls"
    inputs = ("frames", "poses", "flow", "coarse")
    settings = HullSettings
    reads_capture = True
    device_class = True

    def applies(self, facts: Mapping[str, Any], settings: HullSettings) -> Applies:
        if settings.budget == 0:
            return Applies.no("hulls.budget is 0")
        return Applies.yes(f"up to {settings.budget} convexes where edges are dense")

    def estimate(self, facts: Mapping[str, Any], settings: HullSettings) -> float | None:
        return 2.0 + 0.3 * settings.views * facts.get("width", 0) * facts.get("height", 0) / 1e6

    def resources(self, facts: Mapping[str, Any], settings: HullSettings, device: str) -> Resources:
        from .estimates import training_resources

        return training_resources(facts, device)

    def run(self, ctx: Context) -> None:
        import numpy as np

        from ..scene.edge_seeds import edge_density
        from ..scene.fibonacci import fibonacci_hulls, neighbour_radius
        from ..scene.primitives import SH_C0
        from .artifacts.dataset import load_frameset, load_views
        from .artifacts.training import read_model, required

        settings = ctx.settings
        model = read_model(required(ctx.inputs["coarse"])).to(ctx.device)
        views = load_views(load_frameset(ctx.inputs, ctx.capture.root), ctx.inputs["flow"], ctx.device, model)
        chosen = views.train[np.linspace(0, len(views.train) - 1, min(settings.views, len(views.train))).round().astype(int)]
        density, weight = edge_density(model, views, [int(i) for i in chosen])

        eligible = np.flatnonzero((density >= settings.min_edge_density) & (weight > 1.0))
        order = eligible[np.argsort(-(density * np.sqrt(weight))[eligible], kind="stable")][: settings.budget]
        order = np.sort(order)
        centres = model.gaussians.means.detach().cpu().numpy()[order].astype(np.float64)
        limit = 0.05 * views.viewing_distance(centres) if len(centres) else 1.0
        radii = np.minimum(neighbour_radius(centres) * settings.radius, limit)
        colors = model.gaussians.sh_dc.detach().cpu().numpy()[order, 0] * SH_C0 + 0.5

        reason = f"{len(order)} of {len(density)} Gaussians lie on edges (mean edge weight >= {settings.min_edge_density})"
        ctx.log(reason)
        ctx.out.write("points", fibonacci_hulls(centres, radii, settings.k).astype(np.float32), unit="world unit")
        ctx.out.write("colors", colors.clip(0, 1).astype(np.float32))
        ctx.out.write("seed", order.astype(np.int32), doc="row of the Gaussian in `coarse`")
        ctx.out.write("edge_density", density[order].astype(np.float32), doc="mean edge weight under the seed")
        ctx.out.attrs.update(k=settings.k, reason=reason)
