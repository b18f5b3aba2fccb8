"""`seeds`: places where Gaussians begin, with depth maps of what is static."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...pipeline import Applies, Context, Resources, Stage
from ..facts import Facts
from .settings import SeedsSettings


class Seeds(Stage):
    """Seeds on what is static and, at several times, on what moves; the near plane, and inverse depth maps from a plane sweep."""

    name = "seeds"
    inputs = ("frames", "poses", "depth", "flow")
    settings = SeedsSettings
    reads_capture = True

    def applies(self, facts: Mapping[str, Any], settings: SeedsSettings) -> Applies:
        known = Facts.of(facts)
        if known.points or not known.poses:
            return Applies.yes("Gaussians begin at the points of " + ("the capture" if known.points else "structure from motion"))
        if known.alpha:
            return Applies.yes("Gaussians begin inside the silhouettes")
        return Applies.yes("Gaussians begin at points that are triangulated with the known poses")

    def estimate(self, facts: Mapping[str, Any], settings: SeedsSettings) -> float | None:
        from ..estimates import seeds_seconds

        return seeds_seconds(Facts.of(facts), settings.motion)

    def resources(self, facts: Mapping[str, Any], settings: SeedsSettings, device: str) -> Resources:
        from ..estimates import training_resources

        return training_resources(Facts.of(facts), "cpu")

    def run(self, ctx: Context) -> None:
        from .run import place_seeds

        place_seeds(ctx)
