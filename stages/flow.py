"""Stage `flow`: measured optical flow between neighbouring times of one camera, edge weights, and what fixed cameras see change.

Only training frames are ever looked at: a held-out picture must not steer training. Pictures are streamed camera by camera, so memory
does not grow with the capture. Arrays and attrs: docs/artifacts.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from ..pipeline import Applies, Context, Given, Resources, Settings, Stage

if TYPE_CHECKING:
    from .artifacts.frameset import FrameSet

SMALL_WEIGHTS = 10_000_000  # bytes; the small network's file has 4 MB, the basic one's 21 MB


class FlowSettings(Settings):
    method: Literal["auto", "raft", "raft-small", "dis"] = Field(
        "auto",
        description="auto: RAFT where weights are given, else dense inverse search of OpenCV; raft without weights takes torchvision's",
    )
    weights: Path | None = Field(None, description="RAFT's published weights, basic or small, as safetensors or .pth")
    iterations: int = Field(20, ge=1, le=100, description="updates of RAFT at most")
    tolerance: float = Field(0.05, ge=0, le=10, description="px; RAFT stops after an update that moves the flow by less")
    preset: Literal["ultrafast", "fast", "medium"] = Field("medium", description="speed of DIS; medium is the most accurate")
    max_size: int | None = Field(960, ge=64, le=65_536, description="px; flow of larger pictures is computed at this longest side")
    max_pairs: int = Field(400, ge=0, le=1_000_000, description="pairs of frames at most, spread evenly over cameras and times")
    detect_static: bool = Field(
        True, description="find out whether anything moves before measuring; nothing is measured where nothing does"
    )
    movers: bool = Field(True, description="masks of what moves in each frame: flow minus camera motion, or change before a fixed camera")
    grow: int = Field(4, ge=0, le=100, description="px by which the mask of what changes before a fixed camera is widened")


class Flow(Stage):
    """Flow forward and backward with its consistency, edge weights, and masks of what moves."""

    name = "flow"
    items = "pairs"
    inputs = ("frames", "poses")
    settings = FlowSettings
    reads_capture = True
    device_class = True

    def applies(self, facts: Mapping[str, Any], settings: FlowSettings) -> Applies:
        from ..vision.flow.method import choice

        if facts.get("static"):
            return Applies.no("static capture: nothing moves between its frames")
        pairs = int(facts.get("pairs", 0))
        if pairs == 0:
            return Applies.no("every image has its own camera: no two frames of one camera to compare")
        means = choice(settings.method, settings.weights)[1]
        if pairs > settings.max_pairs:
            return Applies.yes(f"{settings.max_pairs} of {pairs} pairs of neighbouring frames of one camera (flow.max_pairs); {means}")
        return Applies.yes(f"{pairs} pairs of neighbouring frames of one camera; {means}")

    def estimate(self, facts: Mapping[str, Any], settings: FlowSettings) -> float | None:
        """Two cores, seconds a pair and megapixel, both directions: medium and the small network fitted to the stage on 90 frames of
        480x270, the others to what their pairs take beside these; putting outlines right takes 0.15 s. The rest takes 0.16 s a frame and
        megapixel, and masks of movers, which are made small, take the same at any size."""
        from ..vision.flow.method import choice, size_within

        width, height = int(facts["width"]), int(facts["height"])
        small_width, small_height = size_within(width, height, settings.max_size)
        each = {"ultrafast": 0.22, "fast": 0.23, "medium": 0.36}[settings.preset]
        if choice(settings.method, settings.weights)[0] == "raft":
            small = settings.method == "raft-small"
            if settings.weights is not None and settings.weights.is_file():
                small = settings.weights.stat().st_size < SMALL_WEIGHTS
            encoding, step = (0.9, 0.22) if small else (3.3, 0.5)
            each = encoding + 2 * step * min(settings.iterations, 14 if settings.tolerance else 100)
        pairs = min(int(facts["pairs"]), settings.max_pairs)
        measured = min(pairs, int(facts.get("new_items", pairs)))
        movers = (0.012 if facts.get("fixed_cameras") else 0.02) if settings.movers else 0.0
        return (
            (2.0 if settings.detect_static else 0.5)
            + (each * small_width * small_height + 0.15 * width * height) * measured / 1e6
            + movers * facts["frames"]
            + 0.16 * facts["frames"] * width * height / 1e6
        )

    def item_parts(self, given: Given) -> Sequence[Any]:
        """The two pictures of each pair, as the lens made them: flow does not depend on poses. The size at which it is measured follows
        from the whole capture, and `TakenFlow` looks at it."""
        from .artifacts.frameset import FrameSet

        frames = FrameSet(given.inputs["frames"], given.capture.root, given.inputs.get("poses"))  # type: ignore[arg-type]
        wanted = choose_pairs(frames, given.settings.max_pairs)
        return [[frames.picture_parts(i, given.digests) for i in (first, int(frames.next[first]))] for first in wanted]

    def resources(self, facts: Mapping[str, Any], settings: FlowSettings, device: str) -> Resources:
        from ..vision.flow.method import choice
        from .estimates import GB_OF_TORCH, picture_resources

        if choice(settings.method, settings.weights)[0] != "raft":
            return picture_resources(facts, 0.3)
        return picture_resources(facts, 4.0, GB_OF_TORCH, gpu=device == "cuda")

    def run(self, ctx: Context) -> None:
        import numpy as np

        from ..vision.sequences import camera_sequences
        from .artifacts.frameset import FrameSet
        from .measured_flow.measure import measure

        frames = FrameSet(ctx.inputs["frames"], ctx.capture.root, ctx.inputs.get("poses"))  # type: ignore[arg-type]
        if ctx.settings.detect_static and nothing_moves(ctx, frames):
            ctx.out.write("pair", np.zeros((0, 2), np.int32), doc="frame and the same camera's next frame")
            ctx.lends = False
            return
        wanted = choose_pairs(frames, ctx.settings.max_pairs)
        cameras = camera_sequences(frames.camera, frames.time, frames.train)
        ctx.out.write(
            "pair",
            np.array([(i, frames.next[i]) for i in wanted], np.int32).reshape(-1, 2),
            doc="frame and the same camera's next frame",
        )
        masks = measure(ctx, frames, cameras, wanted)
        if masks:
            ctx.out.write("moving", np.stack(list(masks.values())), doc="255 where the pixel of a fixed camera changes over time")
            ctx.out.attrs["moving_cameras"] = list(masks)
            still = 100 * float(np.mean([(mask == 0).mean() for mask in masks.values()]))
            ctx.log(f"{still:.0f} % of the pixels of {len(masks)} fixed cameras never change")


def nothing_moves(ctx: Context, frames: FrameSet) -> bool:
    """Whether the training frames show one that is still; attrs `static`, `static_reason`, `moving_share` say what was found."""
    from ..vision.moving.static_scene import static_scene

    chosen, K, poses = frames.train, frames.K, frames.cam_from_world
    with ctx.progress(1, "does anything move?") as bar:
        found = static_scene(
            lambda k: frames.composited(int(chosen[k])),
            frames.camera[chosen],
            frames.time[chosen],
            frames.fixed_cameras,
            None if K is None else K[chosen],
            None if poses is None else poses[chosen],
            frames.untimed,
        )
        bar.advance(1)
    ctx.out.attrs.update(static=found.static, static_reason=found.reason, moving_share=round(found.moving_share, 6))
    if found.static:
        ctx.log(f"nothing moves: {found.reason}; no flow, no deformation (flow.detect_static=false measures all the same)")
    return found.static


def choose_pairs(frames: FrameSet, limit: int) -> list[int]:
    """Training frames whose camera's next frame is a training frame too, by camera and time; evenly thinned to ``limit``."""
    import numpy as np

    from ..vision.sequences import camera_sequences

    usable = {int(i) for i in frames.train}
    pairs = [i for mine in camera_sequences(frames.camera, frames.time, usable).values() for i in mine if int(frames.next[i]) in usable]
    if len(pairs) <= limit:
        return pairs
    return [pairs[int(k)] for k in np.linspace(0, len(pairs), limit, endpoint=False)]
