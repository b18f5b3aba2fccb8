"""Stage `evaluate`: metrics of held-out views against the captured pictures, frames per second, and pictures for the report.

Renders are clamped to [0, 1] and compared as floats, not quantised. The ground truth is the undistorted 8-bit frame, composited on the
capture's background. Frames without a pose are counted but not measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from ..pipeline import Applies, Context, Resources, Settings, Stage
from .evaluation.spread import SAMPLE, flicker_cameras
from .facts import Facts

Split = Literal["train", "val", "test"]


class EvaluateSettings(Settings):
    splits: tuple[Split, ...] = Field(("val", "test"), min_length=1, description="splits to measure, separated by commas")
    max_views: int = Field(8, ge=0, le=1000, description="most views of each split in the report, half of them the worst")
    measured: int | None = Field(
        None,
        ge=1,
        le=1_000_000,
        description="most views of each split that are measured, spread evenly; none: one for each 50 steps of training, at least 32",
    )
    movie_frames: int = Field(60, ge=0, le=1000, description="pictures in each of the report's two movies; 0: no movies")
    player: bool = Field(True, description="put the scene itself into the report, where it plays and can be turned; at most 8 MB")
    picture_size: int = Field(640, ge=16, le=8192, description="px; longest side of the report's pictures")
    lpips_weights: Path | None = Field(None, description="safetensors file with the network's weights; without it, LPIPS is not measured")
    lpips_net: Literal["alex", "vgg"] = Field("alex", description="network that lpips_weights is for")


class Evaluate(Stage):
    """PSNR, SSIM, PSNR near edges and LPIPS of every held-out view, and of some training views for comparison.

    The model of `fine` is measured, or that of `coarse` if `fine` was skipped.
    """

    name = "evaluate"
    inputs = ("frames", "poses", "flow", "coarse", "fine")
    settings = EvaluateSettings
    reads_capture = True
    device_class = True

    def applies(self, facts: Mapping[str, Any], settings: EvaluateSettings) -> Applies:
        counts = Facts.of(facts).splits
        chosen = [f"{counts[split]} {split} views" for split in settings.splits if counts.get(split)]
        if chosen:
            return Applies.yes(", ".join(chosen))
        return Applies.yes(f"no views in {', '.join(settings.splits)}: training views are measured instead")

    def estimate(self, facts: Mapping[str, Any], settings: EvaluateSettings) -> float | None:
        """On two cores: about 1.2 s per view and megapixel for rendering and metrics, without LPIPS; as much at each time for flicker."""
        known = Facts.of(facts)
        views = SAMPLE + sum(known.splits.get(split, 0) for split in settings.splits)
        if known.fixed_cameras and not known.static:
            views += flicker_cameras(known.times) * known.times
        return 3.0 + 1.2 * views * known.width * known.height / 1e6

    def resources(self, facts: Mapping[str, Any], settings: EvaluateSettings, device: str) -> Resources:
        from .estimates import training_resources

        return training_resources(Facts.of(facts), device)

    def run(self, ctx: Context) -> None:
        from .evaluation.evaluate import evaluate

        evaluate(ctx)
