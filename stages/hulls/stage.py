"""`hulls`: chooses the Gaussians that become convexes: those under which edges are dense and badly shown."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...pipeline import Applies, Context, Resources, Stage
from ...scene.motion.kinds import choose
from ..facts import Facts
from .defaults import VIEWS, most_convexes
from .settings import HullSettings


class Hulls(Stage):
    """Attributes edges, and the error there, to the Gaussians of `coarse`. Those with the most error become convexes in `fine`."""

    name = "hulls"
    inputs = ("frames", "poses", "flow", "coarse")
    settings = HullSettings
    reads_capture = True
    device_class = True

    def applies(self, facts: Mapping[str, Any], settings: HullSettings) -> Applies:
        if settings.budget == 0:
            return Applies.no("hulls.budget is 0")
        most = most_convexes(settings.budget, choose(None, Facts.of(facts)))
        if most == 0:
            return Applies.yes("with control nodes convexes gain nothing, so there are none; hulls.budget sets a number")
        return Applies.yes(f"up to {most} convexes where edges are dense and badly shown")

    def estimate(self, facts: Mapping[str, Any], settings: HullSettings) -> float | None:
        known = Facts.of(facts)
        return 0.5 + 0.13 * VIEWS * known.width * known.height / 1e6

    def resources(self, facts: Mapping[str, Any], settings: HullSettings, device: str) -> Resources:
        from ..estimates import training_resources

        return training_resources(Facts.of(facts), device)

    def run(self, ctx: Context) -> None:
        from .run import place_convexes

        place_convexes(ctx)
