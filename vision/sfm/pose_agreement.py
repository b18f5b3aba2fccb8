"""How well cameras explain matched features: the share of matches that lie on each other's epipolar lines. It needs no ground truth."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ..moving.two_view import sampson
from .epipolar import fundamental

TOLERANCE = 1.0  # px to the epipolar line; features are found to a few tenths of one
DOUBTFUL = 0.75  # of the matches that pairs of frames explain on their own; where poses explain fewer, they follow something else
SUPPORT = 0.5  # share of a frame's matches that must lie in pairs with a fundamental matrix; where parallax is small, few do

# frames a and b, the places [M, 2] px of matched features in them, and the fundamental matrix [3, 3] that RANSAC found for this pair alone;
# None if a homography explains the pair
FreePair = tuple[int, int, np.ndarray, np.ndarray, np.ndarray | None]


@dataclass(frozen=True)
class Matches:
    """Matched features of one capture: match m joins xy1[m] in frame pair[m, 0] with xy2[m] in frame pair[m, 1].

    pair [M, 2] int32, sorted; xy1, xy2 [M, 2] px in the pictures that structure from motion read, pixel centres at +0.5.
    """

    pair: np.ndarray
    xy1: np.ndarray
    xy2: np.ndarray


def agreement(matches: Matches, arrays: Mapping[str, np.ndarray], frames: np.ndarray) -> float:
    """Share of the matches between `frames` [F] bool whose Sampson distance under the cameras is at most `TOLERANCE` px; nan without any.

    arrays: `K` [F, 3, 3] px, `cam_from_world` [F, 4, 4], `distortion` [F, 4] as `reconstruct` returns them, finite for `frames`.
    Distances are measured in the cameras' pinhole images.
    """
    good = total = 0
    starts = np.flatnonzero(np.diff(matches.pair, axis=0, prepend=-1).any(axis=1))
    for start, end in zip(starts, np.append(starts[1:], len(matches.pair)), strict=True):
        a, b = (int(i) for i in matches.pair[start])
        if not (frames[a] and frames[b]):
            continue
        good += int((_distances(arrays, a, b, matches.xy1[start:end], matches.xy2[start:end]) <= TOLERANCE).sum())
        total += int(end - start)
    return good / total if total else float("nan")


def explained(pairs: Iterable[FreePair], arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """[F] how many of a frame's matches the cameras explain, as a multiple of how many the pairs' own fundamental matrices explain; nan for
    frames without a pose, and where less than `SUPPORT` of the matches are in pairs with such a matrix.

    About 1 for good poses, whatever the share of wrong matches. It is far lower where cameras follow something else than most matches
    do: the person whom the camera accompanies, if the background is blurred. Reprojection errors do not show that, because features
    that do not fit are dropped. arrays: as for `agreement`, and `registered`.
    """
    registered = np.asarray(arrays["registered"], bool)
    by_cameras, alone, judged, matched = np.zeros((4, len(registered)))
    for a, b, xy1, xy2, F in pairs:
        if not (registered[a] and registered[b]):
            continue
        matched[[a, b]] += len(xy1)
        if F is not None:
            judged[[a, b]] += len(xy1)
            by_cameras[[a, b]] += (_distances(arrays, a, b, xy1, xy2) <= TOLERANCE).sum()
            alone[[a, b]] += (sampson(F, np.asarray(xy1, np.float64), np.asarray(xy2, np.float64)) <= TOLERANCE).sum()
    return np.divide(by_cameras, alone, out=np.full(len(registered), np.nan), where=(alone > 0) & (judged >= SUPPORT * matched))


def doubtful(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """[F] bool: frames whose poses explain less than `DOUBTFUL` of what they should, by `explained` in `arrays`; none if it is missing."""
    share = arrays.get("explained", np.full(len(arrays["registered"]), np.nan))
    return np.nan_to_num(share, nan=1.0) < DOUBTFUL


def _distances(arrays: Mapping[str, np.ndarray], a: int, b: int, xy1: np.ndarray, xy2: np.ndarray) -> np.ndarray:
    """Sampson distances in px of matches between frames a and b under their cameras."""
    import cv2

    K, poses, distortion = arrays["K"], arrays["cam_from_world"], arrays["distortion"]
    first, second = (
        cv2.undistortPoints(np.asarray(xy, np.float64)[:, None], K[i], distortion[i], P=K[i])[:, 0] for xy, i in ((xy1, a), (xy2, b))
    )
    return sampson(fundamental(K[a], K[b], poses[a], poses[b]), first, second)
