"""`fine`: puts convexes in place of Gaussians where edges are badly shown, and refines both."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import Field

from ..pipeline import Applies, Context, Resources, Stage
from ..scene.motion.kinds import KINDS, choose
from ..scene.settings import RefinementSettings
from .facts import Facts
from .training.choices import fine_iterations


class FineSettings(RefinementSettings):
    iterations: int | None = Field(
        None, ge=0, le=1_000_000, description="optimiser steps; by default 1500, but none for control nodes without convexes"
    )
    effort: float = Field(1.0, gt=0, le=100, description="factor on the number of steps that is chosen by default")
    lr_scale: float = Field(0.3, gt=0, le=1, description="factor on the initial learning rates of what `coarse` has trained")


def rests(facts: Facts, settings: FineSettings) -> bool:
    """Whether there is nothing to do unless `hulls` was told to place convexes."""
    return settings.iterations is None and not KINDS[choose("auto", facts)].convexes


class Fine(Stage):
    """Refines the model of `coarse` together with the convexes of `hulls`."""

    name = "fine"
    inputs = ("frames", "poses", "flow", "hulls", "coarse")
    settings = FineSettings
    reads_capture = True
    device_class = True

    def applies(self, facts: Mapping[str, Any], settings: FineSettings) -> Applies:
        if settings.iterations == 0:
            return Applies.no("fine.iterations is 0")
        if rests(Facts.of(facts), settings):
            return Applies.yes("Gaussians and convexes together; without convexes, control nodes are refined already")
        return Applies.yes("Gaussians and convexes together")

    def estimate(self, facts: Mapping[str, Any], settings: FineSettings) -> float | None:
        from .estimates import training_seconds

        known = Facts.of(facts)
        if rests(known, settings):
            return 2.0
        return training_seconds(known, fine_iterations(settings, known), "static" if known.static else "planes")

    def resources(self, facts: Mapping[str, Any], settings: FineSettings, device: str) -> Resources:
        from .estimates import training_resources

        return training_resources(Facts.of(facts), device)

    def run(self, ctx: Context) -> None:
        from .training.fine import train_fine

        train_fine(ctx)
