"""`coarse`: trains Gaussians to represent the scene's shape and motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field

from ..pipeline import Applies, Context, Resources, Stage
from ..scene.motion.kinds import KINDS, choose
from ..scene.settings import Strategy, TrainingSettings
from .facts import Facts
from .training.choices import auto_iterations


class CoarseSettings(TrainingSettings):
    iterations: int = Field(0, ge=0, le=1_000_000, description="optimiser steps of this stage; 0: chosen for the capture")
    effort: float = Field(1.0, gt=0, le=100, description="factor on the number of steps that is chosen for the capture")
    motion: Literal["auto", "planes", "nodes", "free"] = Field(
        "auto",
        description="what moves primitives: planes, the six-plane field; nodes, control nodes (auto: if each frame is seen from another "
        "side); free, each primitive moves and lives for a time of its own (auto: if masks show what moves)",
    )
    strategy: Strategy = Field("two-stage", description="training strategy, one of the four of Table 3; `fine` uses the same")
    antialiased: bool = Field(
        True,
        description="train and draw in the antialiased mode, which is right at other image sizes and distances, too",
    )
    full_from: float = Field(0.5, ge=0, le=1, description="fraction of the steps that use images of half the size, before the full size")
    seeds: int = Field(
        0, ge=0, le=2_000_000, description="initial number of Gaussians; 0: half the budget for rigs and one camera on its path, else 8000"
    )


class Coarse(Stage):
    """Places seeds, trains a static warm-up and then the deformation, and writes a model without convexes."""

    name = "coarse"
    inputs = ("frames", "poses", "flow")
    settings = CoarseSettings
    reads_capture = True
    device_class = True

    def applies(self, facts: Mapping[str, Any], settings: CoarseSettings) -> Applies:
        return Applies.yes(KINDS[choose(settings.motion, Facts.of(facts))].moves)

    def estimate(self, facts: Mapping[str, Any], settings: CoarseSettings) -> float | None:
        from .estimates import first_training_seconds, training_seconds

        known = Facts.of(facts)
        kind = choose(settings.motion, known)
        steps = settings.iterations or auto_iterations(known, settings, kind)
        area = 1.0 if KINDS[kind].steps else 1 - 0.75 * settings.full_from
        first = KINDS[kind].first_steps(settings.strategy, steps)
        return training_seconds(known, steps, kind, area) + first_training_seconds(first)

    def resources(self, facts: Mapping[str, Any], settings: CoarseSettings, device: str) -> Resources:
        from .estimates import training_resources

        return training_resources(Facts.of(facts), device)

    def run(self, ctx: Context) -> None:
        from .training.coarse import train_coarse

        train_coarse(ctx)
