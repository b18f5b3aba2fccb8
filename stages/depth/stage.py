"""Stage `depth`: depth of single frames, aligned to known points. Skipped where there is none and none is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...pipeline import Applies, Context, Resources, Stage
from ..facts import Facts
from .settings import DepthSettings


class Depth(Stage):
    """Depth maps of the training frames in world units, from the capture's files or from a network."""

    name = "depth"
    inputs = ("frames", "poses")
    settings = DepthSettings
    reads_capture = True
    device_class = True

    def applies(self, facts: Mapping[str, Any], settings: DepthSettings) -> Applies:
        known = Facts.of(facts)
        if settings.model is None and not known.depths:
            return Applies.no("the files hold no depth, and none is asked for (depth.model)")
        if known.alpha and known.poses and not known.points:
            return Applies.no("Gaussians begin inside the silhouettes, which need no depth")
        if settings.model is None:
            return Applies.yes(f"{known.depths} depth maps of the files, aligned to known points")
        instead = f", in place of the {known.depths} depth maps of the files" if known.depths else ""
        name = settings.model.name if isinstance(settings.model, Path) else settings.model
        return Applies.yes(f"depth of {known.splits.get('train', known.frames)} frames by {name}{instead}, aligned to known points")

    def estimate(self, facts: Mapping[str, Any], settings: DepthSettings) -> float | None:
        from ..estimates import depth_seconds

        return depth_seconds(Facts.of(facts), settings.model is not None)

    def resources(self, facts: Mapping[str, Any], settings: DepthSettings, device: str) -> Resources:
        from ..estimates import GB_OF_TORCH, picture_resources

        network = settings.model is not None
        return picture_resources(Facts.of(facts), 0.3, GB_OF_TORCH + (2.0 if network else 0.0), gpu=network and device == "cuda")

    def run(self, ctx: Context) -> None:
        from .run import find_depth

        find_depth(ctx)
