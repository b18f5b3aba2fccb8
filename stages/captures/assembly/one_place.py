"""`joined_place`: whether all frames with poses were taken from one place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..reading import Shot

SAME = 1e-6  # largest difference of two poses, and of two focal lengths as a share


def joined_place(shots: Sequence[Shot]) -> bool:
    """Whether all shots have one pose and one lens, and several times. Then they become those of one camera, whatever the reader took each
    of them for, and their poses and lenses become equal to the bit."""
    first = shots[0]
    if first.cam_from_world is None or first.K is None or not 1 < len({shot.time for shot in shots}) == len(shots):
        return False  # several pictures of one time come from several cameras
    for shot in shots:
        if shot.cam_from_world is None or shot.K is None or shot.size != first.size:
            return False
        if not (np.allclose(shot.cam_from_world, first.cam_from_world, 0, SAME) and np.allclose(shot.K, first.K, SAME, 0)):
            return False
    for shot in shots:
        shot.camera, shot.cam_from_world, shot.K = 0, first.cam_from_world, first.K
    return True
