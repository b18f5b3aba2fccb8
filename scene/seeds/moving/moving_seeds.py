"""Seeds on moving objects, which have velocities."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np


class MovingSeeds(NamedTuple):
    """points [N, 3] world units, colors [N, 3] in [0, 1], velocities [N, 3] world units per frame, time [N] in [0, 1] of each position.
    held: by frame of a camera that is alone, the depth that its seeds assume: what `HeldDepth` says, [2, h, w] float32."""

    points: np.ndarray
    colors: np.ndarray
    velocities: np.ndarray
    time: np.ndarray
    held: Mapping[int, np.ndarray] = {}
