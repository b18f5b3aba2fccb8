"""Stage `poses`: structure from motion for captures without camera poses. docs/artifacts.md documents the arrays and attributes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...pipeline import Applies, Context, Resources, Stage, thread_count
from ...vision.sfm.pairs import MATCHERS, STRONGEST, choose, enlarged, image_pairs, key_frames, many
from ..facts import Facts
from .settings import PosesSettings


class Poses(Stage):
    """Intrinsics and a pose for every frame that registers, sparse points, and a report of which frames did not register and why."""

    name = "poses"
    inputs = ("frames",)
    settings = PosesSettings
    reads_capture = True

    def applies(self, facts: Mapping[str, Any], settings: PosesSettings) -> Applies:
        known = Facts.of(facts)
        if known.poses:
            return Applies.no("the files hold poses")
        if known.cameras > 1 and not known.static:
            return Applies.yes(
                f"structure from motion on {known.cameras} cameras at shared times; those that stand still get one pose each"
            )
        again = "" if not settings.moving or known.static else "; a second pass if moving objects could disturb the cameras"
        still = "" if known.cameras > 1 else ", unless the camera stands still"
        keys = len(key_frames(known.frames)) if known.cameras == 1 and not known.static else known.frames
        some = f"{known.frames}" if keys == known.frames else f"{keys} of {known.frames}"
        return Applies.yes(f"structure from motion on {some} frames{still}{again}")

    def estimate(self, facts: Mapping[str, Any], settings: PosesSettings) -> float | None:
        """Fitted to runs on two cores, second pass included: features 0.05 s + 0.65 s per megapixel (0.18 s where pictures are not
        enlarged), 0.03 s per pair, 0.15 s to register a frame of a video (1.1 s for photos, which lie farther apart), 0.08 s to find moving
        objects, 8 s for the start and the test whether the camera only turns. Several cameras are assumed to stand still, as most do. Among
        `many` frames: features 0.05 s + 0.3 s per megapixel, and 0.02 s per pair and thousand features. A frame between key frames takes
        0.1 s per megapixel."""
        from ...vision.sfm.looks import look_times

        known = Facts.of(facts)
        frames = known.frames
        large = known.cameras == 1 and not enlarged(known.width, known.height, known.static)
        features = 0.05 + (0.18 if large else 0.65) * known.width * known.height / 1e6
        if known.cameras > 1 and not known.static:
            cameras, times = known.cameras, look_times(known.cameras, known.times)
            features, pairs = cameras * times * features, times * cameras * (cameras - 1) / 2
            return 10 + features + 0.2 * pairs + 2.0 * cameras
        between = 0
        if known.cameras == 1 and not known.static:
            frames = len(key_frames(known.frames))
            between = known.frames - frames
        lean = many(frames, known.static)
        pairs = len(image_pairs(choose(settings.matcher, frames, known.static), frames, settings.overlap))
        each = 1.1 if known.static else 0.23 if settings.moving else 0.15
        if lean:
            features, per_pair = 0.05 + 0.3 * known.width * known.height / 1e6, 2e-5 * (settings.max_features or STRONGEST)
        else:
            per_pair = 0.03
        return 8 + frames * (each + features) + per_pair * pairs + 0.1 * between * known.width * known.height / 1e6

    def resources(self, facts: Mapping[str, Any], settings: PosesSettings, device: str) -> Resources:
        from ..estimates import GB_OF_A_MATCHER, GB_OF_PYTHON, picture_resources

        return picture_resources(Facts.of(facts), 2.0, GB_OF_PYTHON + GB_OF_A_MATCHER * thread_count(MATCHERS))

    def run(self, ctx: Context) -> None:
        from .run import pose_capture

        pose_capture(ctx)
