"""`fine`: puts convexes in place of Gaussians where edges are badly shown, and refines both."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...pipeline import Applies, Context, Resources, Stage
from ..facts import Facts
from .defaults import fine_iterations, rests
from .settings import FineSettings


class Fine(Stage):
    """Refines the model of `coarse` together with the convexes of `hulls`."""

    name = "fine"
    inputs = ("frames", "poses", "flow", "seeds", "hulls", "coarse")
    settings = FineSettings
    reads_capture = True
    device_class = True

    def applies(self, facts: Mapping[str, Any], settings: FineSettings) -> Applies:
        if settings.iterations == 0:
            return Applies.no("fine.iterations is 0")
        together = "Gaussians, and convexes where hulls places some"  # how many is a setting of that stage, which is not known here
        if rests(Facts.of(facts), settings):
            return Applies.yes(f"{together}; without any, control nodes are refined already")
        return Applies.yes(together)

    def estimate(self, facts: Mapping[str, Any], settings: FineSettings) -> float | None:
        from ..estimates import training_seconds

        known = Facts.of(facts)
        if rests(known, settings):
            return 2.0
        return training_seconds(known, fine_iterations(settings, known), "static" if known.static else "planes")

    def resources(self, facts: Mapping[str, Any], settings: FineSettings, device: str) -> Resources:
        from ..estimates import training_resources

        return training_resources(Facts.of(facts), device)

    def run(self, ctx: Context) -> None:
        from .run import train_fine

        train_fine(ctx)
