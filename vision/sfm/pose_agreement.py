"""How well cameras explain matched features: the share of matches that lie on each other's epipolar lines. It needs no ground truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..moving.two_view import sampson
from .epipolar import fundamental

TOLERANCE = 1.0  # px to the epipolar line; features are found to a few tenths of one


@dataclass(frozen=True)
class Matches:
    """Matched features of one capture: match m joins xy1[m] in frame pair[m, 0] with xy2[m] in frame pair[m, 1].

    pair [M, 2] int32, sorted; xy1, xy2 [M, 2] px in the pictures that structure from motion read, pixel centres at +0.5.
    """

    pair: np.ndarray
    xy1: np.ndarray
    xy2: np.ndarray


def agreement(matches: Matches, arrays: Mapping[str, np.ndarray], frames: np.ndarray, tolerance: float = TOLERANCE) -> float:
    """Share of the matches between `frames` [F] bool whose Sampson distance under the cameras is at most `tolerance` px; nan without any.

    arrays: `K` [F, 3, 3] px, `cam_from_world` [F, 4, 4], `distortion` [F, 4] as `reconstruct` returns them, finite for `frames`.
    Distances are measured in the cameras' pinhole images.
    """
    import cv2

    K, poses, distortion = arrays["K"], arrays["cam_from_world"], arrays["distortion"]
    good = total = 0
    starts = np.flatnonzero(np.diff(matches.pair, axis=0, prepend=-1).any(axis=1))
    for start, end in zip(starts, np.append(starts[1:], len(matches.pair)), strict=True):
        a, b = (int(i) for i in matches.pair[start])
        if not (frames[a] and frames[b]):
            continue
        first, second = (
            cv2.undistortPoints(np.asarray(xy[start:end], np.float64)[:, None], K[i], distortion[i], P=K[i])[:, 0]
            for xy, i in ((matches.xy1, a), (matches.xy2, b))
        )
        good += int((sampson(fundamental(K[a], K[b], poses[a], poses[b]), first, second) <= tolerance).sum())
        total += int(end - start)
    return good / total if total else float("nan")
