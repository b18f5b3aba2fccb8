"""Stage `flow`: optical flow measured between neighbouring times of one camera, edge weights, and masks of moving pixels.

Only training frames are read, because a held-out picture must not influence training. Pictures are streamed camera by camera, so memory
use does not grow with the capture. docs/artifacts.md documents the arrays and attributes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ...pipeline import Applies, Context, Given, Resources, Stage, counted
from ...vision.flow.method import choice
from ...vision.images.pictures import size_within
from ..facts import Facts
from ..shared.frameset import FrameSet
from .choose_pairs import choose_pairs, most_pairs
from .settings import FlowSettings

SMALL_WEIGHTS = 10_000_000  # bytes; the weights file of the small network has 4 MB, that of the basic one 21 MB


class Flow(Stage):
    """Forward and backward flow with its consistency, edge weights, and masks of moving pixels."""

    name = "flow"
    items = "pairs"
    inputs = ("frames", "poses")
    settings = FlowSettings
    reads_capture = True
    device_class = True

    def applies(self, facts: Mapping[str, Any], settings: FlowSettings) -> Applies:
        known = Facts.of(facts)
        if known.static:
            return Applies.no("static capture: nothing moves between its frames")
        if known.pairs == 0 and known.cameras < known.frames:
            return Applies.no("no two training frames of one camera to compare")
        if known.pairs == 0:
            return Applies.no("every image has its own camera: no two frames of one camera to compare")
        means = choice(settings.method, settings.weights)[1]
        most = most_pairs(settings.max_pairs, known.cameras)
        if known.pairs > most:
            return Applies.yes(f"{most} of {counted(known.pairs, 'pair')} of neighbouring frames of one camera (flow.max_pairs); {means}")
        return Applies.yes(f"{counted(known.pairs, 'pair')} of neighbouring frames of one camera; {means}")

    def estimate(self, facts: Mapping[str, Any], settings: FlowSettings) -> float | None:
        """Seconds per pair and megapixel on two cores, for both directions. DIS medium and the small network are fitted to runs of the
        stage on 90 frames of 480x270; the others are scaled by the time of their pairs relative to these. Correcting outlines takes
        0.09 s. The rest takes 0.1 s per frame and megapixel; masks of moving pixels, made at a small size, take the same at any size."""
        known = Facts.of(facts)
        width, height = known.width, known.height
        small_width, small_height = size_within(width, height, settings.max_size)
        each = {"ultrafast": 0.13, "fast": 0.14, "medium": 0.22}[settings.preset]
        if choice(settings.method, settings.weights)[0] == "raft":
            small = settings.method == "raft-small"
            if settings.weights is not None and settings.weights.is_file():
                small = settings.weights.stat().st_size < SMALL_WEIGHTS
            encoding, step = (0.55, 0.13) if small else (2.0, 0.3)
            each = encoding + 2 * step * min(settings.iterations, 14 if settings.tolerance else 100)
        pairs = min(known.pairs, most_pairs(settings.max_pairs, known.cameras))
        measured = pairs if known.new_items is None else min(pairs, known.new_items)
        moving = (0.008 if known.fixed_cameras else 0.013) if settings.moving else 0.0
        return (
            (2.0 if settings.detect_static else 0.5)
            + (each * small_width * small_height + 0.09 * width * height) * measured / 1e6
            + moving * known.frames
            + 0.1 * known.frames * width * height / 1e6
        )

    def item_parts(self, given: Given) -> Sequence[Any]:
        """The two distorted pictures of each pair, since flow does not depend on poses. The size at which flow is measured depends on the
        whole capture, so `TakenFlow` checks it."""
        frames = FrameSet(given.inputs["frames"], given.capture.root, given.inputs.get("poses"))  # type: ignore[arg-type]
        wanted = choose_pairs(frames, given.settings.max_pairs)
        return [[frames.picture_parts(i, given.digests) for i in (first, int(frames.next[first]))] for first in wanted]

    def resources(self, facts: Mapping[str, Any], settings: FlowSettings, device: str) -> Resources:
        from ..estimates import GB_OF_TORCH, picture_resources

        if choice(settings.method, settings.weights)[0] != "raft":
            return picture_resources(Facts.of(facts), 0.3)
        return picture_resources(Facts.of(facts), 4.0, GB_OF_TORCH, gpu=device == "cuda")

    def run(self, ctx: Context) -> None:
        from .run import measure_capture

        measure_capture(ctx)
