"""Stage `evaluate`: metrics of held-out views against the captured pictures, frames per second, and pictures for the report.

Renders are clamped to [0, 1] and compared as floats, not quantised. The ground truth is the undistorted 8-bit frame, composited on the
capture's background. Frames without a pose are counted but not measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...pipeline import Applies, Context, Resources, Stage, counted
from ..facts import Facts
from .settings import EvaluateSettings
from .spread import SAMPLE, flicker_cameras


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
        chosen = [counted(counts[split], f"{split} view") for split in settings.splits if counts.get(split)]
        if chosen:
            return Applies.yes(", ".join(chosen))
        return Applies.yes(f"no views in {', '.join(settings.splits)}: training views are measured instead")

    def estimate(self, facts: Mapping[str, Any], settings: EvaluateSettings) -> float | None:
        """Two cores take about 0.7 s for each view and megapixel, and as much at each time whose flicker is measured. The
        report's movies and the scene in it come on top."""
        known = Facts.of(facts)
        views = SAMPLE + sum(known.splits.get(split, 0) for split in settings.splits)
        if known.fixed_cameras and not known.static:
            views += flicker_cameras(known.times) * known.times
        return 2.0 + 0.7 * views * known.width * known.height / 1e6 + 0.09 * settings.movie_frames

    def resources(self, facts: Mapping[str, Any], settings: EvaluateSettings, device: str) -> Resources:
        from ..estimates import GB_PER_MEGAPIXEL_MEASURED, training_resources

        return training_resources(Facts.of(facts), device, GB_PER_MEGAPIXEL_MEASURED)

    def run(self, ctx: Context) -> None:
        from .run import evaluate

        evaluate(ctx)
