"""The work of `poses`: structure from motion on the capture's pictures, in passes of the worker process."""

from __future__ import annotations

import numpy as np

from ...pipeline import Context, StageError
from ...vision.sfm.coverage import cover
from ...vision.sfm.fixed_cameras import SHAKEN, is_fixed
from ...vision.sfm.pairs import choose, image_pairs
from ...vision.sfm.pose_agreement import doubtful
from ...vision.sfm.runner import WorkerError, finished, run_worker
from ...vision.sfm.trouble import nothing_registered
from ..facts import Facts
from ..shared.frameset import FrameSet
from .artifact import write_account
from .bars import Bars
from .pictures import lens_groups, picture_folder, write_images, write_masks, write_picture
from .second_pass import second_pass
from .several import Several, several_cameras
from .standing import write_standing
from .write import write_poses

INIT_ANGLES = (16.0, 4.0, 1.5)  # degrees, least triangulation angle of the initial image pair; tried in order, from good to last resort


def pose_capture(ctx: Context) -> None:
    """Finds cameras and points and writes the artifact. Raises StageError if fewer than three frames register."""
    settings, static = ctx.settings, Facts.of(ctx.facts).static
    artifact = ctx.inputs["frames"]
    assert artifact is not None
    frames = FrameSet(artifact, ctx.capture.root)
    matcher = choose(settings.matcher, len(frames), static)
    hint = frames.K_hint
    one_camera = len(np.unique(frames.camera)) == 1
    if one_camera and is_fixed(frames.original, [int(i) for i in np.argsort(frames.time, kind="stable")], SHAKEN):
        write_standing(ctx, frames)
        return
    several = None if one_camera or static else _several(ctx, frames)
    request = {
        "task": "reconstruct",
        "root": str(ctx.checkpoints / "images"),
        "names": [] if several else write_images(ctx, frames),
        "cameras": lens_groups(frames),
        "K_hint": None if hint is None else np.asarray(hint, np.float64).reshape(3, 3).tolist(),
        "keep": str(write_masks(ctx, frames)) if frames.masked else None,
        "width": frames.width,
        "height": frames.height,
        "camera_model": settings.camera_model,
        "max_features": settings.max_features,
        "pairs": [] if several else image_pairs(matcher, len(frames), settings.overlap),
        "mapper": settings.mapper,
        "init_angles": INIT_ANGLES,
        "static": static,
        "seed": settings.seed,
        **(several.request if several else {}),
    }
    bars, folder = Bars(ctx), ctx.checkpoints / "colmap"
    share, told = None, "poses.moving=off"
    try:
        arrays, facts = finished(request, folder) or run_worker(request, folder, bars)
        if several and several.looks.fixed:
            told = "cameras that stand still are matched only at equal times, when moving objects are as useful as static ones"
        elif settings.moving:
            passes = second_pass(frames, request, folder, (arrays, facts), static, bars)
            arrays, facts, share, told = passes.arrays, passes.facts, passes.moving_share, passes.told
            if passes.trouble:
                ctx.log(passes.trouble)
    except WorkerError as error:
        # The next run must not resume from these databases: one of them may be the cause of the failure.
        for database in folder.glob("*.db"):
            database.unlink(missing_ok=True)
        raise StageError(str(error)) from error
    finally:
        bars.close()

    if several:
        arrays, facts = several.of_frames(frames, arrays, facts)
    residuals = arrays["residuals"]
    if arrays["registered"].sum() < min(3, len(frames)) or not len(residuals):
        raise StageError(nothing_registered(len(frames), facts["features"], facts["pairs"], matcher))
    mean_error, median_error = float(residuals.mean()), float(np.median(residuals))
    angle = float(np.median(arrays["angles"]))
    # If the camera only turns, a note already says so, and small angles need no further advice.
    judged = 90.0 if facts["turning"] else angle
    unsure = np.zeros(len(frames), bool) if several else doubtful(arrays)
    if several:
        write_account(ctx.out, fixed_cameras=several.looks.all_fixed)
    coverage = cover(arrays["registered"], facts["features"], facts["parts"], matcher, mean_error, judged, unsure)
    ctx.log(f"{coverage.summary()}, mean reprojection error {mean_error:.2f} px, median {median_error:.2f} px")
    for sentence in facts["notes"]:
        ctx.log(sentence)
    if settings.moving:
        ctx.log(f"moving objects: {told}")
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
        matcher=matcher,
        moving_share=None if share is None else round(share, 4),
        second_pass=told,
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
