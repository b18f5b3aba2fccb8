"""Chooses the pairs of frames between which flow is measured. Imports nothing heavy, since planning uses it too."""

from __future__ import annotations

import numpy as np

from ...vision.sequences import camera_sequences
from ..shared.frameset import FrameSet

MOST, MOST_OF_ONE = 400, 600  # pairs of several cameras, which thin out well; and of one, whose tracks end where a pair is missing


def most_pairs(given: int | None, cameras: int) -> int:
    """Most pairs of a capture: as ``given``, or as is usual for so many cameras."""
    return given if given is not None else MOST_OF_ONE if cameras == 1 else MOST


def choose_pairs(frames: FrameSet, most: int | None) -> list[int]:
    """Training frames whose successor in the same camera is a training frame too, sorted by camera and time, evenly thinned to
    ``most_pairs``."""
    limit = most_pairs(most, len(np.unique(frames.camera)))
    usable = {int(i) for i in frames.train}
    pairs = [i for mine in camera_sequences(frames.camera, frames.time, usable).values() for i in mine if int(frames.next[i]) in usable]
    if len(pairs) <= limit:
        return pairs
    return [pairs[int(k)] for k in np.linspace(0, len(pairs), limit, endpoint=False)]
