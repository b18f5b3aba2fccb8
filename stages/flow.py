"""Stage `flow`: measured optical flow between neighbouring times of one camera, edge weights, and what fixed cameras see change.

Only training frames are ever looked at: a held-out picture must not steer training. Pictures are streamed camera by camera, so memory
does not grow with the capture. Arrays and attrs: docs/artifacts.md.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from ..pipeline import Applies, Context, Settings, Stage

if TYPE_CHECKING:
    import numpy as np

    from .frameset import FrameSet

_STEPS = 32  # stored flow is a multiple of 1/32 px: a tenth of DIS's error, and the array compresses to a third
_LIMIT = 65504.0  # px, the largest float16


class FlowSettings(Settings):
    method: Literal["dis"] = Field("dis", description="dense inverse search of OpenCV")
    preset: Literal["ultrafast", "fast", "medium"] = Field("medium", description="speed of DIS; medium is the most accurate")
    max_size: int | None = Field(960, ge=64, le=65_536, description="px; flow of larger pictures is computed at this longest side")
    max_pairs: int = Field(400, ge=0, le=1_000_000, description="pairs of frames at most, spread evenly over cameras and times")
    grow: int = Field(4, ge=0, le=100, description="px by which the mask of what changes before a fixed camera is widened")


class Flow(Stage):
    """Flow forward and backward with its consistency, edge weights, and masks of what moves."""

    name = "flow"
    version = 1
    inputs = ("frames", "poses")
    settings = FlowSettings
    reads_capture = True

    def applies(self, facts: Mapping[str, Any], settings: FlowSettings) -> Applies:
        if facts.get("static"):
            return Applies.no("static capture: nothing moves between its frames")
        pairs = int(facts.get("pairs", 0))
        if pairs == 0:
            return Applies.no("every image has its own camera: no two frames of one camera to compare")
        if pairs > settings.max_pairs:
            return Applies.yes(f"{settings.max_pairs} of {pairs} pairs of neighbouring frames of one camera (flow.max_pairs)")
        return Applies.yes(f"{pairs} pairs of neighbouring frames of one camera")

    def estimate(self, facts: Mapping[str, Any], settings: FlowSettings) -> float | None:
        """Two cores, from the processor time of a 640x360 capture: medium 0.18 s a pair and megapixel, the rest 0.14 s a frame."""
        megapixels = facts["width"] * facts["height"] / 1e6
        each = {"ultrafast": 0.05, "fast": 0.06, "medium": 0.18}[settings.preset]
        return 1.0 + megapixels * (each * min(int(facts["pairs"]), settings.max_pairs) + 0.14 * facts["frames"])

    def run(self, ctx: Context) -> None:
        import numpy as np

        from .frameset import FrameSet

        frames = FrameSet(ctx.inputs["frames"], ctx.capture.root, ctx.inputs.get("poses"))  # type: ignore[arg-type]
        wanted = {first: p for p, first in enumerate(choose_pairs(frames, ctx.settings.max_pairs))}
        cameras = {int(c): _by_time(frames, c) for c in np.unique(frames.camera[frames.train])}
        ctx.out.write(
            "pair",
            np.array([(i, frames.next[i]) for i in wanted], np.int32).reshape(-1, 2),
            doc="frame and the same camera's next frame",
        )
        masks = _measure(ctx, frames, cameras, wanted)
        if masks:
            ctx.out.write("moving", np.stack(list(masks.values())), doc="255 where the pixel of a fixed camera changes over time")
            ctx.out.attrs["moving_cameras"] = list(masks)
            still = 100 * float(np.mean([(mask == 0).mean() for mask in masks.values()]))
            ctx.log(f"{still:.0f} % of the pixels of {len(masks)} fixed cameras never change")
        ctx.out.attrs["method"] = f"{ctx.settings.method}-{ctx.settings.preset}"


def choose_pairs(frames: FrameSet, limit: int) -> list[int]:
    """Training frames whose camera's next frame is a training frame too, by camera and time; evenly thinned to ``limit``."""
    import numpy as np

    usable = {int(i) for i in frames.train}
    order = sorted(usable, key=lambda i: (int(frames.camera[i]), float(frames.time[i]), i))
    pairs = [i for i in order if int(frames.next[i]) in usable]
    if len(pairs) <= limit:
        return pairs
    return [pairs[int(k)] for k in np.linspace(0, len(pairs), limit, endpoint=False)]


def _by_time(frames: FrameSet, camera: int) -> list[int]:
    mine = [int(i) for i in frames.train if frames.camera[i] == camera]
    return sorted(mine, key=lambda i: (float(frames.time[i]), i))


def _measure(ctx: Context, frames: FrameSet, cameras: Mapping[int, list[int]], wanted: Mapping[int, int]) -> dict[int, np.ndarray]:
    """Fills the large arrays, one pass over each camera's frames; returns the masks [H, W] uint8 of fixed cameras by their number."""
    from ..scene.edges import edge_weights
    from .motion_mask import MotionMask, sample
    from .optical_flow import flow_pair

    height, width, count = frames.height, frames.width, len(wanted)
    shape, chunk = (count, height, width, 2), (1, height, width, 2)
    forward = ctx.out.create("forward", shape, "float16", chunk, unit="px", doc="flow to the second frame, u right, v down")
    backward = ctx.out.create("backward", shape, "float16", chunk, unit="px", doc="flow from the second frame to the first")
    confidence = ctx.out.create(
        "confidence", shape[:3], "uint8", chunk[:3], doc="255 = consistent forward and backward, in the first frame"
    )
    edges = ctx.out.create("edges", (len(frames), height, width), "uint8", (1, height, width), doc="255 = edge; 0 outside training frames")

    def work(moving: MotionMask | None, i: int, picture: np.ndarray, before: tuple[int, np.ndarray] | None) -> None:
        edges[i] = edge_weights(picture)
        if moving is not None:
            moving.add(picture)
        if before is not None and before[0] in wanted and int(frames.next[before[0]]) == i:
            p = wanted[before[0]]
            pair = flow_pair(before[1], picture, ctx.settings.preset, ctx.settings.max_size)
            forward[p], backward[p], confidence[p] = _stored(pair.forward), _stored(pair.backward), pair.confidence

    trained = {i for mine in cameras.values() for i in mine}
    for i in range(len(frames)):
        if i not in trained:
            edges[i] = 0
    masks: dict[int, np.ndarray] = {}
    with ctx.progress(len(trained), f"{count} pairs") as bar, ThreadPoolExecutor(_threads()) as pool, _one_thread_each():
        for camera, mine in cameras.items():
            moving = None
            if ctx.facts.get("fixed_cameras") and len(mine) > 1:
                moving = MotionMask(list(pool.map(frames.composited, sample(mine))))
            before, busy = None, deque[Future[None]]()
            for i in mine:
                picture = frames.composited(i)
                busy.append(pool.submit(work, moving, i, picture, before))
                before = i, picture
                if len(busy) > 2 * _threads():  # bounds the pictures in memory
                    busy.popleft().result()
                bar.advance(1, frames.names[i])
            for future in busy:
                future.result()
            if moving is not None:
                masks[camera] = moving.mask(ctx.settings.grow)
    return masks


def _threads() -> int:
    return min(8, os.cpu_count() or 1)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Frames run side by side here; OpenCV's own threads inside each picture would cost half again as much processor time."""
    import cv2

    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def _stored(flow: np.ndarray) -> np.ndarray:
    import numpy as np

    return (np.rint(np.clip(flow, -_LIMIT, _LIMIT) * _STEPS) / _STEPS).astype(np.float16)
