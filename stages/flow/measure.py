"""The main loop of stage `flow`: one pass over each camera's frames that reads each picture once."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from ...pipeline import Context, thread_count
from ...pipeline.choice.evenly import evenly
from ...scene.edges import edge_weights
from ...vision.edges import Seen, seen_by, stable_edges
from ...vision.flow.method import FlowMethod
from ...vision.flow.two_way import consistency
from ...vision.moving.motion_mask import SAMPLES, MotionMask
from ..shared.frameset import FrameSet
from .artifact_writer import FlowArrays, FlowWriter
from .moving_masks import MovingMasks
from .pairs import PairFlows, Shown, Source

if TYPE_CHECKING:
    import zarr

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


class _Jobs:
    """What threads compute of a frame and of a pair. arrays: where it is stored. number: the pair that begins at a frame."""

    def __init__(self, flows: PairFlows, arrays: FlowArrays, wanted: Sequence[int], device: str) -> None:
        self.flows, self.arrays, self._device = flows, arrays, device
        self.number = {first: p for p, first in enumerate(wanted)}

    def look(self, camera: _Camera, k: int, both: tuple[np.ndarray, np.ndarray], paired: bool) -> Looked:
        """Frame ``k`` of a camera. both: its picture as stored and undistorted. paired: whether it belongs to a pair."""
        seen, picture = both
        if camera.changes is not None:
            camera.changes.add(picture)
        if camera.gathered is not None:
            camera.gathered.add_picture(k, picture)
        return Looked(edge_weights(picture), self.flows.shown(camera.mine[k], seen) if paired else None)

    def match(self, camera: _Camera, k: int, first: Future[Looked], second: Future[Looked]) -> Matched:
        """The pair of frame ``k`` of a camera and the next one."""
        a, b, p = first.result(), second.result(), self.number[camera.mine[k]]
        assert a.shown is not None and b.shown is not None
        pair, source = self.flows.between(p, a.shown, b.shown)
        if camera.gathered is not None:
            camera.gathered.add_pair(k, pair)
        arrays = self.arrays
        arrays.forward[p], arrays.backward[p], arrays.confidence[p] = pair.forward, pair.backward, pair.confidence
        back = consistency(pair.backward, pair.forward, self._device)
        first_sees = seen_by(b.edges, pair.forward, pair.confidence, self._device)
        return Matched(first_sees, seen_by(a.edges, pair.backward, back, self._device), source)

    def finish(self, i: int, own: Future[Looked], before: Future[Matched] | None, after: Future[Matched] | None) -> str:
        """Stores the edges of frame ``i`` that its pairs confirm, and says where the flow after it comes from."""
        seen = ([before.result().second] if before else []) + ([after.result().first] if after else [])
        self.arrays.edges[i] = stable_edges(own.result().edges, seen)
        return after.result().flow if after is not None else ""


class _Masks:
    """Masks of moving pixels, made for one camera after another beside the pairs of the next ones, and stored in that order.

    fixed: masks [H, W] uint8 of fixed cameras, by camera index. moved: sum over frames of the share that moves. followed: for each frame
    with moving pixels and a pair, the share of these where forward and backward flow agree. came: where the flow of pairs came from.
    """

    def __init__(self, ctx: Context, frames: FrameSet, jobs: _Jobs, pool: ThreadPoolExecutor, advance: Callable[[int, str], None]) -> None:
        self._ctx, self._frames, self._jobs, self._pool, self._advance = ctx, frames, jobs, pool, advance
        self._matched = deque[_Camera]()
        self._begun = deque[tuple[_Camera, Future[np.ndarray] | None, list[Future[list[np.ndarray]]]]]()
        self.fixed: dict[int, np.ndarray] = {}
        self.moved, self.followed, self.came = 0.0, list[float](), Counter[str]()

    def add(self, camera: _Camera, behind: int) -> None:
        """A camera whose pairs have been submitted. behind: number of cameras whose masks may wait to be stored."""
        self._matched.append(camera)
        if len(self._matched) > 1:
            self._begin()
        if len(self._begun) > behind:
            self._store()

    def finish(self) -> None:
        """Store the masks of all cameras."""
        while self._matched:
            self._begin()
        while self._begun:
            self._store()

    def _begin(self) -> None:
        """Submit the jobs for the camera whose pairs were submitted first."""
        one = self._matched.popleft()
        self.came.update(future.result() for future in one.frames)
        static = None if one.changes is None else self._pool.submit(one.changes.mask, self._ctx.settings.grow)
        self._begun.append((one, static, [] if one.gathered is None else one.gathered.masks(self._pool)))

    def _store(self) -> None:
        """Wait for the masks of the camera that has waited longest, and store them."""
        one, static, jobs = self._begun.popleft()
        arrays, number = self._jobs.arrays, self._jobs.number
        if static is not None:
            self.fixed[one.camera] = static.result()
        for i, mask in zip(one.mine if jobs else (), (mask for job in jobs for mask in job.result()), strict=True):
            kept = self._frames.kept(i)
            mask = mask if kept is None else np.where(kept, mask, 0)  # no seeds on ignored pixels
            assert arrays.moving is not None
            arrays.moving[i] = mask
            self.moved += np.count_nonzero(mask) / mask.size
            if i in number and mask.any():
                self.followed.append(float((np.asarray(arrays.confidence[number[i]])[mask > 0] > 0).mean()))
            self._advance(1, self._frames.names[i])


def measure(
    ctx: Context, frames: FrameSet, cameras: Mapping[int, list[int]], wanted: Sequence[int], out: FlowWriter
) -> dict[int, np.ndarray]:
    """Fills the arrays for the pairs that begin at ``wanted``, edges and, if asked for, masks of moving pixels, and logs a summary.

    Everything is derived from the flow as it is stored, rounded, so that reused flow gives the same results as measured flow.
    cameras: training frames of each camera in order of time. Returns the masks [H, W] uint8 of fixed cameras, by camera index.
    """
    arrays = out.create_arrays(len(wanted), len(frames), frames.height, frames.width, moving=ctx.settings.moving and bool(wanted))
    flows, moving, fixed, threads = PairFlows(ctx, frames, wanted, out), arrays.moving, frames.fixed_cameras, thread_count(8)
    trained = {i for mine in cameras.values() for i in mine}
    for i in sorted(set(range(len(frames))) - trained):
        arrays.edges[i] = 0
        if moving is not None:
            moving[i] = 0
    jobs = _Jobs(flows, arrays, wanted, ctx.device)
    with (
        ctx.progress(len(trained) * (1 + (moving is not None)), f"{len(wanted)} pairs, {flows.method_name}") as bar,
        _pool(flows.method) as pool,
    ):
        masks = _Masks(ctx, frames, jobs, pool, bar.advance)
        for camera, mine in cameras.items():
            changes = MotionMask(list(pool.map(frames.composited, evenly(mine, SAMPLES)))) if fixed and len(mine) > 1 else None
            gathered = MovingMasks.of_camera(frames, mine, fixed) if moving is not None else None
            one = _Camera(camera, mine, changes, gathered, deque())
            masks.came.update(_submit(one, frames, jobs, pool, threads, bar.advance))
            masks.add(one, threads // 2)
        masks.finish()
    if moving is not None:
        _conclude_moving(ctx, frames, trained, moving, masks, out)
    _tell_sources(ctx, masks.came, len(wanted), out)
    return masks.fixed


def _submit(
    one: _Camera, frames: FrameSet, jobs: _Jobs, pool: ThreadPoolExecutor, threads: int, advance: Callable[[int, str], None]
) -> list[str]:
    """Submits the jobs of all frames and pairs of a camera. Those of its last frames are left in ``one.frames``; returns where the flow of
    the others came from."""
    mine, busy, came = one.mine, one.frames, list[str]()
    waiting = deque[tuple[int, Future[Looked], Future[Matched] | None, Future[Matched] | None]]()
    own: Future[Looked] | None = None
    before: Future[Matched] | None = None  # the pair that ends at the previous frame
    for k, i in enumerate(mine):
        # Every job is submitted after the jobs that it waits for, so it never waits for one behind it in the queue.
        last, joined = own, k > 0 and mine[k - 1] in jobs.number and int(frames.next[mine[k - 1]]) == i
        own = pool.submit(jobs.look, one, k, frames.both(i), joined or i in jobs.number)
        if last is not None:
            after = pool.submit(jobs.match, one, k - 1, last, own) if joined else None
            waiting.append((mine[k - 1], last, before, after))
            before = after
        # A frame is finished only some frames after its last pair was submitted, so that no thread idles waiting for the pair.
        if len(waiting) > threads:
            busy.append(pool.submit(jobs.finish, *waiting.popleft()))
        if len(busy) > 2 * threads:  # bounds the pictures in memory
            came.append(busy.popleft().result())
        advance(1, frames.names[i])
    if own is not None:
        waiting.append((mine[-1], own, before, None))
    busy.extend(pool.submit(jobs.finish, *job) for job in waiting)
    return came


def _conclude_moving(ctx: Context, frames: FrameSet, trained: set[int], moving: zarr.Array, masks: _Masks, out: FlowWriter) -> None:
    """Says how much moves. Where flow fails on what seems to move, masks say nothing, and nothing counts as moving."""
    share = float(np.median(masks.followed)) if masks.followed else 1.0
    moved = masks.moved / max(len(trained), 1)
    fails = share < FAILED and ctx.settings.detect_static and not frames.fixed_cameras and frames.mask_files is None
    if fails:
        for i in trained:
            moving[i] = 0
        moved, reason = 0.0, f"forward and backward flow agree at {100 * share:.0f} % of what seems to move, so flow fails there"
        out.write_static(True, reason, 0.0)
        ctx.log(
            f"nothing moves as far as can be told: {reason}; no deformation (flow.detect_static=false trains one anyway); if something "
            "does move, more frames per second help"
        )
    out.write_moving_share(moved)
    ctx.log(f"{100 * moved:.0f} % of the pixels show something that moves")
    if not fails and share < FOLLOWED:
        ctx.log(
            "moving objects move too far between frames to be followed: forward and backward flow agree at "
            f"{100 * share:.0f} % of their pixels; expect them to be blurred or torn between frames; more frames per second help"
        )


def _tell_sources(ctx: Context, came: Mapping[str, int], count: int, out: FlowWriter) -> None:
    """Stores and says from where the flow of the ``count`` pairs came."""
    static, measured, taken = (came.get(source, 0) for source in ("static", "measured", "taken"))
    out.write_counts(static=static, measured=measured, taken_over=taken)
    if static:
        ctx.log(f"nothing moves between the frames of {static} of {count} pairs: their flow is zero and was not measured")
    if taken:
        ctx.log(f"flow of {taken} of {count} pairs is reused from an earlier result; that of {measured} was measured")


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
