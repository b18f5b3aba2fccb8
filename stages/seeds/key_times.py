"""At which times seeds are placed on what moves. A seed moves steadily and lives for about as long as there is to the next of these times,
so the faster things move, the closer they are."""

from __future__ import annotations

import numpy as np

from ...pipeline.choice.evenly import evenly
from ..flow.artifact import StoredFlow

KEYS = 24  # least number of times at which seeds are placed
APART = 8  # frames; if these times of a rig would lie farther apart, more are used,
WAY = 0.014  # of the image's width; also if moving pixels would move farther between them
APART_ALONE, WAY_ALONE = 3, 0.03  # the same for one camera: closer times fit its own frames better and those between worse
SLOWER = 75  # percent of the moving pixels, that is: the others are faster
LEAST_AT_ONCE = 250  # seeds; so many remain for each time of a rig that has more than `KEYS`
PAIRS = 60  # of frames in which the speed is measured


def key_times(times: np.ndarray, apart: float, most: int | None = None) -> np.ndarray:
    """Indices into ``times`` [T] of the key times, at which seeds are placed: evenly spread, including the first and the last; about
    ``apart`` frames from one another, but at least `KEYS` and not more than ``most``."""
    count = max(KEYS, int(len(times) / apart))
    return evenly(np.arange(len(times)), min(count, most or count))


def apart_by_speed(farthest: float, way: float, speed: float) -> float:
    """Frames between key times: ``farthest``, or fewer, but at least one, so that what moves at ``speed``, in widths of the image a frame,
    gets no farther than ``way`` between them."""
    return max(min(farthest, way / max(speed, 1e-6)), 1.0)


def rig_times(flow: StoredFlow, times: np.ndarray, most: int) -> np.ndarray:
    """Indices into the training times ``times`` [T] of the key times of a rig, which share ``most`` seeds."""
    return key_times(times, apart_by_speed(APART, WAY, speed(flow)), max(KEYS, most // LEAST_AT_ONCE))


def speed(flow: StoredFlow) -> float:
    """How far moving pixels move between neighbouring frames, in widths of the image: `SLOWER` percent of them are slower. 0 if nothing
    moves."""
    found = []
    for p in range(0, len(flow.pairs), max(1, len(flow.pairs) // PAIRS)):
        row = flow.moving(flow.pairs[p][0]) > 127
        if row.any():
            found.append(np.linalg.norm(flow.forward(p)[row].astype(np.float32), axis=1))
    return float(np.percentile(np.concatenate(found), SLOWER)) / flow.size[1] if found else 0.0
