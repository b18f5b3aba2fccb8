"""`coarse`: trains Gaussians to represent the scene's shape and motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...pipeline import Applies, Context, Resources, Stage
from ..facts import Facts
from ..shared.defaults import use_nodes
from .defaults import BY_NODE_PHASES, auto_iterations
from .settings import CoarseSettings


class Coarse(Stage):
    """Trains a static warm-up and then the deformation, from the seeds, and writes a model without convexes."""

    name = "coarse"
    inputs = ("frames", "poses", "flow", "seeds")
    settings = CoarseSettings
    reads_capture = True
    device_class = True

    def applies(self, facts: Mapping[str, Any], settings: CoarseSettings) -> Applies:
        known = Facts.of(facts)
        if known.static:
            return Applies.yes("nothing moves: Gaussians without a deformation field")
        if use_nodes(known, settings.motion):
            return Applies.yes("Gaussians, moved by control nodes")
        if settings.motion == "free" or (settings.motion == "auto" and known.pairs):
            return Applies.yes("Gaussians; those on moving pixels live around a time of their own")
        return Applies.yes("Gaussians, moved by the six-plane field")

    def estimate(self, facts: Mapping[str, Any], settings: CoarseSettings) -> float | None:
        from ...scene.training.schedule import first_motion_steps
        from ..estimates import node_training_seconds, training_seconds

        known = Facts.of(facts)
        steps = settings.iterations or auto_iterations(known, settings)
        if use_nodes(known, settings.motion):
            first = first_motion_steps(steps) if settings.strategy in BY_NODE_PHASES else 0
            return node_training_seconds(known, steps, first)
        return training_seconds(known, steps, known.static, area=1 - 0.75 * settings.full_from)

    def resources(self, facts: Mapping[str, Any], settings: CoarseSettings, device: str) -> Resources:
        from ..estimates import training_resources

        return training_resources(Facts.of(facts), device)

    def run(self, ctx: Context) -> None:
        from .run import train_coarse

        train_coarse(ctx)
