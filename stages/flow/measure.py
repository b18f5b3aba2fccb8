"""The main loop of stage `flow`: one pass over each camera's frames that reads each picture once."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from typing import NamedTuple

import cv2
import numpy as np

from ...pipeline import Context, thread_count
from ...scene.edges import edge_weights
from ...vision.edges import Seen, seen_by, stable_edges
from ...vision.flow.method import FlowMethod
from ...vision.flow.two_way import consistency
from ...vision.moving.motion_mask import MotionMask, sample
from ..shared.frameset import FrameSet
from .artifact_writer import FlowWriter
from .moving_masks import MovingMasks
from .pairs import PairFlows, Shown, Source

FOLLOWED = 0.5  # share of moving pixels where forward and backward flow agree; below it the motion of these pixels is not known
FAILED = 0.25  # the same; below it, flow fails between pictures that are far apart, and masks say nothing about what moves


class Looked(NamedTuple):
    """What the pairs of a frame need from it: edge weights uint8 [H, W], and the input of flow."""

    edges: np.ndarray
    shown: Shown | None


class Matched(NamedTuple):
    """first: the second frame's edges, warped to the first. second: the first frame's edges, warped to the second. flow: where the flow of
    the pair comes from."""

    first: Seen
    second: Seen
    flow: Source


class _Camera(NamedTuple):
    """A camera whose pairs have been submitted. frames: for each training frame, a job that ends when its edges are stored."""

    camera: int
    mine: list[int]
    changes: MotionMask | None
    gathered: MovingMasks | None
    frames: deque[Future[str]]


def measure(
    ctx: Context, frames: FrameSet, cameras: Mapping[int, list[int]], wanted: Sequence[int], out: FlowWriter
) -> dict[int, np.ndarray]:
    """Fills the arrays for the pairs that begin at ``wanted``, edges and, if asked for, masks of moving pixels, and logs a summary.

    Everything is derived from the flow as it is stored, rounded, so that reused flow gives the same results as measured flow.
    cameras: training frames of each camera in order of time. Returns the masks [H, W] uint8 of fixed cameras, by camera index.
    """
    height, width, count = frames.height, frames.width, len(wanted)
    number = {first: p for p, first in enumerate(wanted)}
    arrays = out.create_arrays(count, len(frames), height, width, moving=ctx.settings.moving and bool(wanted))
    edges, moving = arrays.edges, arrays.moving
    flows = PairFlows(ctx, frames, wanted, out)

    def look(
        changes: MotionMask | None, gathered: MovingMasks | None, k: int, i: int, both: tuple[np.ndarray, np.ndarray], paired: bool
    ) -> Looked:
        seen, picture = both
        if changes is not None:
            changes.add(picture)
        if gathered is not None:
            gathered.add_picture(k, picture)
        return Looked(edge_weights(picture), flows.shown(i, seen) if paired else None)

    def match(p: int, gathered: MovingMasks | None, k: int, first: Future[Looked], second: Future[Looked]) -> Matched:
        a, b = first.result(), second.result()
        assert a.shown is not None and b.shown is not None
        pair, source = flows.between(p, a.shown, b.shown)
        if gathered is not None:
            gathered.add_pair(k, pair)
        arrays.forward[p], arrays.backward[p], arrays.confidence[p] = pair.forward, pair.backward, pair.confidence
        back = consistency(pair.backward, pair.forward)
        return Matched(seen_by(b.edges, pair.forward, pair.confidence), seen_by(a.edges, pair.backward, back), source)

    def finish(i: int, own: Future[Looked], before: Future[Matched] | None, after: Future[Matched] | None) -> str:
        seen = ([before.result().second] if before else []) + ([after.result().first] if after else [])
        edges[i] = stable_edges(own.result().edges, seen)
        return after.result().flow if after is not None else ""

    trained = {i for mine in cameras.values() for i in mine}
    for i in range(len(frames)):
        if i not in trained:
            edges[i] = 0
            if moving is not None:
                moving[i] = 0
    masks: dict[int, np.ndarray] = {}
    came, moved, followed, threads = Counter[str](), 0.0, list[float](), thread_count(8)
    fixed = frames.fixed_cameras
    with (
        ctx.progress(len(trained) * (1 + (moving is not None)), f"{count} pairs, {flows.method_name}") as bar,
        _pool(flows.method) as pool,
    ):
        matched, masked = deque[_Camera](), deque[tuple[_Camera, Future[np.ndarray] | None, list[Future[list[np.ndarray]]]]]()

        def look_for_motion() -> None:
            """Submit the jobs for the masks of the camera whose pairs were submitted first."""
            one = matched.popleft()
            came.update(future.result() for future in one.frames)
            static = None if one.changes is None else pool.submit(one.changes.mask, ctx.settings.grow)
            masked.append((one, static, [] if one.gathered is None else one.gathered.masks(pool)))

        def write_masks() -> None:
            """Wait for the masks of the camera that has waited longest, and store them."""
            nonlocal moved
            one, static, jobs = masked.popleft()
            if static is not None:
                masks[one.camera] = static.result()
            for i, mask in zip(one.mine if jobs else (), (mask for job in jobs for mask in job.result()), strict=True):
                kept = frames.kept(i)
                mask = mask if kept is None else np.where(kept, mask, 0)  # no seeds on ignored pixels
                assert moving is not None
                moving[i] = mask
                moved += np.count_nonzero(mask) / mask.size
                if i in number and mask.any():
                    followed.append(float((np.asarray(arrays.confidence[number[i]])[mask > 0] > 0).mean()))
                bar.advance(1, frames.names[i])

        for camera, mine in cameras.items():
            changes = MotionMask(list(pool.map(frames.composited, sample(mine)))) if fixed and len(mine) > 1 else None
            gathered = MovingMasks.of_camera(frames, mine, fixed) if moving is not None else None
            busy = deque[Future[str]]()
            waiting = deque[tuple[int, Future[Looked], Future[Matched] | None, Future[Matched] | None]]()
            own: Future[Looked] | None = None
            before: Future[Matched] | None = None  # the pair that ends at the previous frame
            for k, i in enumerate(mine):
                # Every job is submitted after the jobs that it waits for, so it never waits for one behind it in the queue.
                last, joined = own, k > 0 and mine[k - 1] in number and int(frames.next[mine[k - 1]]) == i
                own = pool.submit(look, changes, gathered, k, i, frames.both(i), joined or i in number)
                if last is not None:
                    after = pool.submit(match, number[mine[k - 1]], gathered, k - 1, last, own) if joined else None
                    waiting.append((mine[k - 1], last, before, after))
                    before = after
                # A frame is finished only some frames after its last pair was submitted, so that no thread idles waiting for the pair.
                if len(waiting) > threads:
                    busy.append(pool.submit(finish, *waiting.popleft()))
                if len(busy) > 2 * threads:  # bounds the pictures in memory
                    came[busy.popleft().result()] += 1
                bar.advance(1, frames.names[i])
            if own is not None:
                waiting.append((mine[-1], own, before, None))
            busy.extend(pool.submit(finish, *job) for job in waiting)
            # Masks are made one after another for each camera, so those of a few cameras are made beside the pairs of the next ones.
            matched.append(_Camera(camera, mine, changes, gathered, busy))
            if len(matched) > 1:
                look_for_motion()
            if len(masked) > threads // 2:
                write_masks()
        while matched:
            look_for_motion()
        while masked:
            write_masks()
    if moving is not None:
        share = float(np.median(followed)) if followed else 1.0
        fails = share < FAILED and ctx.settings.detect_static and not fixed and frames.mask_files is None
        if fails:
            for i in trained:
                moving[i] = 0
            moved, reason = 0.0, f"forward and backward flow agree at {100 * share:.0f} % of what seems to move, so flow fails there"
            out.write_static(True, reason, 0.0)
            ctx.log(
                f"nothing moves as far as can be told: {reason}; no deformation (flow.detect_static=false trains one anyway); if something "
                "does move, more frames per second help"
            )
        out.write_moving_share(moved / max(len(trained), 1))
        ctx.log(f"{100 * moved / max(len(trained), 1):.0f} % of the pixels show something that moves")
        if not fails and share < FOLLOWED:
            ctx.log(
                "moving objects move too far between frames to be followed: forward and backward flow agree at "
                f"{100 * share:.0f} % of their pixels; expect them to be blurred or torn between frames; more frames per second help"
            )
    out.write_counts(static=came["static"], measured=came["measured"], taken_over=came["taken"])
    if came["static"]:
        ctx.log(f"nothing moves between the frames of {came['static']} of {count} pairs: their flow is zero and was not measured")
    if came["taken"]:
        ctx.log(f"flow of {came['taken']} of {count} pairs is reused from an earlier result; that of {came['measured']} was measured")
    return masks


@contextmanager
def _pool(method: FlowMethod | None) -> Iterator[ThreadPoolExecutor]:
    """A thread pool that processes frames in parallel. Threads within each picture as well would cost half again as much CPU time."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with method.side_by_side() if method else nullcontext() as begin, ThreadPoolExecutor(thread_count(8), initializer=begin) as pool:
            yield pool
    finally:
        cv2.setNumThreads(threads)
