"""Chooses the views of an evaluation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...pipeline import StageError
from ..shared.posed_frameset import PosedFrameSet
from .judge import Judge
from .spread import spread

TRAIN_VIEWS = 32  # training views that are measured if nothing is held out


def choose_views(frames: PosedFrameSet, splits: Sequence[str], most: int | None = None) -> tuple[dict[str, list[int]], list[str]]:
    """Frames with a pose for each of ``splits``, at most ``most`` of each, in the order train, val, test; and sentences on what is missing.

    If no split has any, training views are used instead. Raises StageError if no training frame has a pose either.
    """
    views: dict[str, list[int]] = {}
    notes = []
    for number, split in enumerate(("train", "val", "test")):
        total = int((frames.split == number).sum())
        posed = [int(i) for i in np.flatnonzero((frames.split == number) & frames.registered)]
        if split not in splits:
            continue
        if posed:
            views[split] = posed if most is None else spread(posed, most)
        if most is not None and len(posed) > most:
            notes.append(
                f"{most} of {len(posed)} {split} frames are measured, spread evenly, so that it takes at most a tenth of the training; "
                f"--set evaluate.measured={len(posed)} measures all"
            )
        if len(posed) < total:
            notes.append(f"{total - len(posed)} of {total} {split} frames have no pose and are not measured")
    if not views:
        posed = [int(i) for i in np.flatnonzero((frames.split == 0) & frames.registered)]
        if not posed:
            raise StageError("no frame has a pose, so there is no view to measure; see the coverage report of `poses`")
        views["train"] = spread(posed, TRAIN_VIEWS)
        notes.append(
            f"no {' or '.join(splits)} views: {len(views['train'])} of {len(posed)} training views are measured, "
            f"which says nothing about new views; hold some out with --set frames.holdout={min(8, max(2, len(frames.split)))}"
        )
    return views, notes


def time_strip(
    judge: Judge, frames: PosedFrameSet, indices: Sequence[int]
) -> tuple[str, list[tuple[float, np.ndarray, np.ndarray | None]]]:
    """One camera over time: the name of its first view, and up to eight (time, render float32 [H, W, 3], ground truth uint8 or None).

    If the first view's camera is fixed and saw at least three of the views, these are shown. Otherwise the model is rendered from the
    first view at evenly spread times, without ground truth; a static model gives no pictures.
    """
    first = indices[0]
    mine = sorted((i for i in indices if frames.camera[i] == frames.camera[first]), key=lambda i: float(frames.time[i]))
    fixed = all(np.allclose(frames.cam_from_world[i], frames.cam_from_world[first], atol=1e-6) for i in mine)
    if fixed and len(mine) >= 3:
        return frames.names[first], [(float(frames.time[i]), judge.render(i)[0], frames.composited(i)) for i in spread(mine, 8)]
    if judge.model.motion.static:
        return frames.names[first], []
    return frames.names[first], [(float(t), judge.render(first, float(t))[0], None) for t in np.linspace(0, 1, 8)]
