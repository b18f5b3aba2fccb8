"""`coarse`: trains Gaussians to represent the scene's shape and motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...pipeline import Applies, Context, Resources, Stage
from ...scene.motion.kinds import KINDS, choose
from ..facts import Facts
from .defaults import auto_iterations
from .settings import CoarseSettings


class Coarse(Stage):
    """Trains a static warm-up and then the deformation, from the seeds, and writes a model without convexes."""

    name = "coarse"
    inputs = ("frames", "poses", "flow", "seeds")
    settings = CoarseSettings
    reads_capture = True
    device_class = True

    def applies(self, facts: Mapping[str, Any], settings: CoarseSettings) -> Applies:
        return Applies.yes(KINDS[choose(settings.motion, Facts.of(facts))].moves)

    def estimate(self, facts: Mapping[str, Any], settings: CoarseSettings) -> float | None:
        from ..estimates import first_training_seconds, training_seconds

        known = Facts.of(facts)
        kind, steps = choose(settings.motion, known), settings.iterations or auto_iterations(known, settings)
        area = 1.0 if KINDS[kind].steps else 1 - 0.75 * settings.full_from
        return training_seconds(known, steps, kind, area) + first_training_seconds(KINDS[kind].first_steps(settings.strategy, steps))

    def resources(self, facts: Mapping[str, Any], settings: CoarseSettings, device: str) -> Resources:
        from ..estimates import training_resources

        return training_resources(Facts.of(facts), device)

    def run(self, ctx: Context) -> None:
        from .run import train_coarse

        train_coarse(ctx)
