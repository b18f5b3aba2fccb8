"""Chooses the pairs of frames between which flow is measured. Imports nothing heavy, since planning uses it too."""

from __future__ import annotations

import numpy as np

from ...vision.sequences import camera_sequences
from ..shared.frameset import FrameSet


def choose_pairs(frames: FrameSet, limit: int) -> list[int]:
    """Training frames whose successor in the same camera is a training frame too, sorted by camera and time, evenly thinned to
    ``limit``."""
    usable = {int(i) for i in frames.train}
    pairs = [i for mine in camera_sequences(frames.camera, frames.time, usable).values() for i in mine if int(frames.next[i]) in usable]
    if len(pairs) <= limit:
        return pairs
    return [pairs[int(k)] for k in np.linspace(0, len(pairs), limit, endpoint=False)]
