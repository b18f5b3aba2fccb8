"""`solve_sparsely`: structure from motion on a part of a long sequence's frames, whose points pose the frames between."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...pipeline import Artifact, Context
from ...vision.sfm.between.pose_between import pose_between
from ...vision.sfm.pairs import key_frames
from ..shared.frameset import FrameSet
from .bars import Bars
from .lens_groups import lens_groups
from .solve import Solved, solve

ENOUGH = 0.5  # of all frames; if fewer have a pose, they may not be in order, or show too little of one another


def solve_sparsely(ctx: Context, artifact: Artifact, frames: FrameSet, bars: Bars) -> Solved:
    """Cameras and points of the ``frames`` [F] of one camera, which are those of the ``frames`` ``artifact``: of all at once if they are
    few, show several lenses, or if a part of them does not pose the others. Raises StageError if the worker fails."""
    keys = key_frames(len(frames))
    if len(keys) == len(frames) or len(set(lens_groups(frames)[0])) > 1:  # frames between are posed with the lens of the next
        return solve(ctx, frames, None, bars)
    found = solve(ctx, FrameSet(artifact, ctx.capture.root, chosen=keys), None, bars, "key_frames")
    done, most = 0, len(frames) - len(keys)

    def advance() -> None:
        nonlocal done
        done += 1
        bars("between", done, most)

    bars("between", 0, most)
    arrays = pose_between(keys, found.arrays, len(frames), frames.original, advance)
    posed = int(arrays["registered"].sum())
    if posed < ENOUGH * len(frames):
        ctx.log(
            f"from every {keys[1]}th frame, {posed} of {len(frames)} frames get a pose; structure from motion begins again on all of them"
        )
        return solve(ctx, frames, None, bars)
    added = posed - int(found.arrays["registered"].sum())
    note = f"structure from motion used {len(keys)} frames; its points posed {added} of the {most} frames between them"
    features = [found.facts["features"][k] for k in np.searchsorted(keys, np.arange(len(frames)), "right") - 1]
    return replace(found, arrays=arrays, facts={**found.facts, "features": features, "notes": [*found.facts["notes"], note]})
