"""`plausible`: whether a pose with little evidence agrees with the poses of its neighbours in time."""

from __future__ import annotations

import numpy as np

SLACK = 3.0  # times the distance that the camera travels in that time: how far it may be from where it is expected
TURN = 30.0, 5.0  # degrees: how far a camera may turn in any case, and in addition per frame
REACH = 20  # frames to the nearest neighbour with a pose; a farther one tells nothing


def plausible(centre: np.ndarray, rotation: np.ndarray, frame: int, frames: np.ndarray, centres: np.ndarray, rotations: np.ndarray) -> bool:
    """Whether `frame` can have been taken at `centre` [3] with `rotation` [3, 3] (cam from world), given the cameras of `frames` [N] of
    the same capture, sorted: centres [N, 3] in the same world, rotations [N, 3, 3].

    Between two neighbours, the camera is expected on the straight line from one to the other; past either end, at the last known place.
    It may be off by `SLACK` times the distance travelled between the neighbours, or the usual distance in that time, whichever is larger.
    False without a neighbour within `REACH` frames, and for poses that are not finite.
    """
    if not (np.isfinite(centre).all() and np.isfinite(rotation).all()) or len(frames) < 2:
        return False
    usual = float(np.median(np.linalg.norm(np.diff(centres, axis=0), axis=1) / np.diff(frames)))
    after = int(np.searchsorted(frames, frame))
    before = after - 1
    near = [n for n in (before, after) if 0 <= n < len(frames)]
    gap = min(abs(int(frames[n]) - frame) for n in near)
    if gap > REACH:
        return False
    if len(near) == 2:
        span = int(frames[after] - frames[before])
        share = (frame - frames[before]) / span
        expected = (1 - share) * centres[before] + share * centres[after]
        way = max(float(np.linalg.norm(centres[after] - centres[before])), usual * span)
    else:
        expected, way = centres[near[0]], usual * gap
    nearest = min(near, key=lambda n: abs(int(frames[n]) - frame))
    cosine = (np.trace(rotation @ rotations[nearest].T) - 1) / 2
    turn = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    return bool(np.linalg.norm(centre - expected) <= SLACK * way and turn <= TURN[0] + TURN[1] * gap)
