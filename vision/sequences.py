"""The frames of a capture as sequences: each camera's frames in order of time."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby

import numpy as np


def camera_sequences(camera: np.ndarray, time: np.ndarray, frames: Iterable[int] | None = None) -> dict[int, list[int]]:
    """The ``frames`` of each camera in order of time, ties by frame number. Cameras come by number; those without frames are left out.

    camera, time [F]: for all frames of the capture. frames: numbers of the frames to use, in any order; None for all.
    """
    chosen = range(len(camera)) if frames is None else (int(i) for i in frames)
    order = sorted(chosen, key=lambda i: (int(camera[i]), float(time[i]), i))
    return {number: list(mine) for number, mine in groupby(order, key=lambda i: int(camera[i]))}
