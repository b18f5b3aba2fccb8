"""The work of `poses`: structure from motion on the capture's pictures, and what is said and written about its result."""

from __future__ import annotations

from contextlib import closing

import numpy as np

from ...pipeline import Context, StageError
from ...vision.sfm.coverage import cover
from ...vision.sfm.fixed_cameras import SHAKEN, is_fixed
from ...vision.sfm.pose_agreement import doubtful
from ...vision.sfm.trouble import nothing_registered
from ..facts import Facts
from ..shared.frameset import FrameSet
from .artifact import write_account
from .bars import Bars
from .pictures import picture_folder, write_picture
from .several import Several, several_cameras
from .solve import solve
from .sparsely import solve_sparsely
from .standing import write_standing
from .write import write_poses


def pose_capture(ctx: Context) -> None:
    """Finds cameras and points and writes the artifact. Raises StageError if fewer than three frames register."""
    settings, static = ctx.settings, Facts.of(ctx.facts).static
    artifact = ctx.inputs["frames"]
    assert artifact is not None
    frames = FrameSet(artifact, ctx.capture.root)
    one_camera = len(np.unique(frames.camera)) == 1
    if one_camera and is_fixed(frames.original, [int(i) for i in np.argsort(frames.time, kind="stable")], SHAKEN):
        write_standing(ctx, frames)
        return
    several = None if one_camera or static else _several(ctx, frames)
    with closing(Bars(ctx)) as bars:
        found = solve_sparsely(ctx, artifact, frames, bars) if one_camera and not static else solve(ctx, frames, several, bars)
    arrays, facts = found.arrays, found.facts
    residuals = arrays["residuals"]
    if arrays["registered"].sum() < min(3, len(frames)) or not len(residuals):
        raise StageError(nothing_registered(len(frames), facts["features"], facts["pairs"], found.matcher))
    mean_error, median_error = float(residuals.mean()), float(np.median(residuals))
    angle = float(np.median(arrays["angles"]))
    # If the camera only turns, a note already says so, and small angles need no further advice.
    judged = 90.0 if facts["turning"] else angle
    unsure = np.zeros(len(frames), bool) if several else doubtful(arrays)
    if several:
        write_account(ctx.out, fixed_cameras=several.looks.all_fixed)
    coverage = cover(arrays["registered"], facts["features"], facts["parts"], found.matcher, mean_error, judged, unsure)
    ctx.log(f"{coverage.summary()}, mean reprojection error {mean_error:.2f} px, median {median_error:.2f} px")
    for sentence in facts["notes"]:
        ctx.log(sentence)
    if settings.moving:
        ctx.log(f"moving objects: {found.told}")
    for sentence in coverage.advice:
        ctx.log(sentence)
    write_poses(ctx, frames, arrays, coverage)
    write_account(
        ctx.out,
        mean_reprojection_error=mean_error,
        median_reprojection_error=median_error,
        median_angle=angle,
        parts=facts["parts"],
        notes=facts["notes"],
        matcher=found.matcher,
        moving_share=None if found.moving_share is None else round(found.moving_share, 4),
        second_pass=found.told,
    )


def _several(ctx: Context, frames: FrameSet) -> Several:
    """The worker's request for a capture with several cameras. Writes the pictures that it uses."""
    folder = picture_folder(ctx)
    with ctx.progress(Facts.of(ctx.facts).cameras, "which cameras stand still") as bar:
        found = several_cameras(
            frames,
            ctx.checkpoints / "colmap",
            ctx.settings.matcher,
            ctx.settings.overlap,
            lambda i: write_picture(frames, i, folder),
            lambda: bar.advance(1),
        )
    ctx.log(found.told)
    return found
