"""`fine`: puts convexes in place of Gaussians where edges are badly shown, and refines both."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import Field

from ..pipeline import Applies, Context, Resources, Stage
from ..scene.settings import RefinementSettings
from .facts import Facts


class FineSettings(RefinementSettings):
    iterations: int = Field(1500, ge=0, le=1_000_000, description="optimiser steps of this stage")
    lr_scale: float = Field(0.3, gt=0, le=1, description="factor on the initial learning rates of what `coarse` has trained")


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
        return Applies.yes("Gaussians and convexes together")

    def estimate(self, facts: Mapping[str, Any], settings: FineSettings) -> float | None:
        from .estimates import training_seconds

        known = Facts.of(facts)
        return training_seconds(known, settings.iterations, known.static)

    def resources(self, facts: Mapping[str, Any], settings: FineSettings, device: str) -> Resources:
        from .estimates import training_resources

        return training_resources(Facts.of(facts), device)

    def run(self, ctx: Context) -> None:
        from .training.fine import train_fine

        train_fine(ctx)
