"""`hulls`: initial convexes. Fibonacci spheres around seeds where edges are dense, sized by the distance to their neighbours."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import Field

from ..pipeline import Applies, Context, Resources, Settings, Stage
from .facts import Facts


class HullSettings(Settings):
    k: int = Field(6, ge=3, le=8, description="number of points of a convex")
    budget: int = Field(2500, ge=0, le=200_000, description="most convexes; 0: none")
    min_edge_density: float = Field(0.25, ge=0, le=1, description="least mean edge weight under a seed, over the views that show it")
    radius: float = Field(1.0, gt=0, le=10, description="radius of a convex: factor on the mean distance to its three nearest neighbours")
    views: int = Field(24, ge=1, description="number of training views in which edges are measured")


class Hulls(Stage):
    """Attributes edge density to the Gaussians of `coarse` that are blended at edge pixels. Those with the most become seeds."""

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
        known = Facts.of(facts)
        return 2.0 + 0.3 * settings.views * known.width * known.height / 1e6

    def resources(self, facts: Mapping[str, Any], settings: HullSettings, device: str) -> Resources:
        from .estimates import training_resources

        return training_resources(Facts.of(facts), device)

    def run(self, ctx: Context) -> None:
        from .training.hulls import place_convexes

        place_convexes(ctx)
