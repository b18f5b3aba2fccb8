"""`misfit`: how far matched features are from where the cameras predict them, to compare candidates on the same matches. It needs no
ground truth."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..moving.two_view import sampson
from .epipolar import fundamental

NOISE = 0.1  # px; smaller distances do not count as better
FARTHEST = 10.0  # px; larger distances do not count as worse; also used for cameras without a pose

Places = Mapping[tuple[int, int], tuple[np.ndarray, np.ndarray]]


def misfit(matches: Places, arrays: Mapping[str, np.ndarray]) -> float:
    """Mean logarithm of the matches' Sampson distances in px, limited to `NOISE` and `FARTHEST`: a difference of 0.1 means typical
    distances a tenth smaller. With the logarithm, wrong matches count no more than good ones, and no scale has to be known.

    matches {(a, b): ([M, 2], [M, 2])}: px in images a and b, pixel centres at +0.5. arrays: those of `reconstruct`.
    """
    import cv2

    K, poses, distortion, registered = (arrays[name] for name in ("K", "cam_from_world", "distortion", "registered"))
    distances = []
    for (a, b), places in matches.items():
        if not len(places[0]):  # the pair was matched, but without a result
            continue
        if not (registered[a] and registered[b]):
            distances.append(np.full(len(places[0]), FARTHEST))
            continue
        first, second = (
            cv2.undistortPoints(np.asarray(xy, np.float64)[:, None], K[i], distortion[i], P=K[i])[:, 0]
            for xy, i in zip(places, (a, b), strict=True)
        )
        distances.append(sampson(fundamental(K[a], K[b], poses[a], poses[b]), first, second))
    every = np.concatenate(distances) if distances else np.full(1, FARTHEST)
    return float(np.log(np.hypot(np.minimum(np.nan_to_num(every, nan=FARTHEST), FARTHEST), NOISE)).mean())
