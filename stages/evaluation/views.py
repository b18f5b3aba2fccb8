"""Which views an evaluation looks at."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...pipeline import StageError
from ..artifacts.frameset import FrameSet
from .judge import Judge
from .spread import spread

TRAIN_VIEWS = 32  # where nothing is held out, so many training views stand in


def choose_views(frames: FrameSet, splits: Sequence[str]) -> tuple[dict[str, list[int]], list[str]]:
    """Frames with a pose of each split, in the order of ``splits``, and sentences about what is missing.

    Where no split has any, training views stand in. Raises StageError where no frame has a pose.
    """
    views: dict[str, list[int]] = {}
    notes = []
    for number, split in enumerate(("train", "val", "test")):
        total = int((frames.split == number).sum())
        posed = [int(i) for i in np.flatnonzero((frames.split == number) & frames.registered)]
        if split not in splits:
            continue
        if posed:
            views[split] = posed
        if len(posed) < total:
            notes.append(f"{total - len(posed)} of {total} {split} frames have no pose and are not measured")
    if not views:
        posed = [int(i) for i in np.flatnonzero((frames.split == 0) & frames.registered)]
        if not posed:
            raise StageError("no frame has a pose, so there is no view to measure; see the coverage report of `poses`")
        views["train"] = spread(posed, TRAIN_VIEWS)
        notes.append(
            f"no {' or '.join(splits)} views: {len(views['train'])} of {len(posed)} training views are measured, "
            "which says nothing about new views; hold some out with --set frames.holdout=8"
        )
    return views, notes


def time_strip(judge: Judge, frames: FrameSet, indices: Sequence[int]) -> tuple[str, list[tuple[float, np.ndarray, np.ndarray | None]]]:
    """One camera over time: its name and up to eight (time, render float32 [H, W, 3], ground truth uint8 or None).

    A camera that saw several times of the split is followed through them; else the first view's camera stands still in time.
    """
    first = indices[0]
    mine = sorted((i for i in indices if frames.camera[i] == frames.camera[first]), key=lambda i: float(frames.time[i]))
    assert frames.cam_from_world is not None
    fixed = all(np.allclose(frames.cam_from_world[i], frames.cam_from_world[first], atol=1e-6) for i in mine)
    if fixed and len(mine) >= 3:
        return frames.names[first], [(float(frames.time[i]), judge.render(i)[0], frames.composited(i)) for i in spread(mine, 8)]
    if judge.model.field is None:
        return frames.names[first], []
    return frames.names[first], [(float(t), judge.render(first, float(t))[0], None) for t in np.linspace(0, 1, 8)]
