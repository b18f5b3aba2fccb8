"""`solve`: structure from motion on a set of frames, in passes of the worker process."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...pipeline import Context, StageError
from ...vision.sfm.pairs import choose, image_pairs
from ...vision.sfm.runner import WorkerError, finished, run_worker
from ..facts import Facts
from ..shared.frameset import FrameSet
from .bars import Bars
from .lens_groups import lens_groups
from .pictures import write_images, write_masks
from .second_pass import second_pass
from .several import Several

INIT_ANGLES = (16.0, 4.0, 1.5)  # degrees, least triangulation angle of the initial image pair; tried in order, from good to last resort


@dataclass(frozen=True)
class Solved:
    """arrays, facts: of the worker, for the frames (`worker/reconstruct.py`). matcher: which was used. moving_share: of the features that
    lie on moving objects; None: not determined. told: what was done about these, for people."""

    arrays: dict[str, np.ndarray]
    facts: dict[str, Any]
    matcher: str
    moving_share: float | None
    told: str


def solve(ctx: Context, frames: FrameSet, several: Several | None, bars: Bars, below: str = "colmap") -> Solved:
    """Cameras and points of ``frames``. several: what is used of several cameras. below: folder of databases among the checkpoints. Raises
    StageError if the worker fails."""
    settings, static, hint = ctx.settings, Facts.of(ctx.facts).static, frames.K_hint
    matcher = choose(settings.matcher, len(frames), static)
    groups, lenses = lens_groups(frames)
    if lenses and not several:
        ctx.log(lenses)
    request = {
        "task": "reconstruct",
        "root": str(ctx.checkpoints / "images"),
        "names": [] if several else write_images(ctx, frames),
        "cameras": groups,
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
    folder = ctx.checkpoints / below
    try:
        arrays, facts = finished(request, folder) or run_worker(request, folder, bars)
        if several:
            told = "poses.moving=off"
            if several.looks.fixed:
                told = "cameras that stand still are matched only at equal times, when moving objects are as useful as static ones"
            return Solved(*several.of_frames(frames, arrays, facts), matcher, None, told)
        if not settings.moving:
            return Solved(arrays, facts, matcher, None, "poses.moving=off")
        passes = second_pass(frames, request, folder, (arrays, facts), static, bars)
    except WorkerError as error:
        # The next run must not resume from these databases: one of them may be the cause of the failure.
        for database in folder.glob("*.db"):
            database.unlink(missing_ok=True)
        raise StageError(str(error)) from error
    if passes.trouble:
        ctx.log(passes.trouble)
    return Solved(passes.arrays, passes.facts, matcher, passes.moving_share, passes.told)
