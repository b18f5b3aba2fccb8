"""The work of `flow`: tests whether anything moves, then measures flow between neighbouring frames, edges and masks of moving pixels."""

from __future__ import annotations

import numpy as np

from ...pipeline import Context
from ...vision.moving.static_scene import static_scene
from ...vision.sequences import camera_sequences
from ..shared.frameset import FrameSet
from .artifact_writer import FlowWriter
from .choose_pairs import choose_pairs
from .measure import measure


def measure_capture(ctx: Context) -> None:
    """Measures everything that `flow` stores. In a static scene nothing is measured."""
    out = FlowWriter(ctx.out)
    frames = FrameSet(ctx.inputs["frames"], ctx.capture.root, ctx.inputs.get("poses"))  # type: ignore[arg-type]
    if ctx.settings.detect_static and nothing_moves(ctx, frames, out):
        out.write_pairs([])
        ctx.lends = False
        return
    wanted = choose_pairs(frames, ctx.settings.max_pairs)
    cameras = camera_sequences(frames.camera, frames.time, frames.train)
    out.write_pairs([(i, int(frames.next[i])) for i in wanted])
    masks = measure(ctx, frames, cameras, wanted, out)
    if masks:
        out.write_ever_moving(masks)
        static = 100 * float(np.mean([(mask == 0).mean() for mask in masks.values()]))
        ctx.log(f"{static:.0f} % of the pixels of {len(masks)} fixed cameras never change")


def nothing_moves(ctx: Context, frames: FrameSet, out: FlowWriter) -> bool:
    """Whether the training frames show a static scene. The finding is written to the artifact."""
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
    out.write_static(found.static, found.reason, found.largest_moving_share)
    if found.static:
        ctx.log(f"nothing moves: {found.reason}; no flow and no deformation (flow.detect_static=false measures flow anyway)")
    return found.static
