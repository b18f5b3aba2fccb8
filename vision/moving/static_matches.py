"""Tests whether the distinctive features of two pictures obey one camera motion. Groups of features that contradict it are moving."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .two_view import TwoView, sampson, transfer, two_view

MAX_FEATURES = 1200
RATIO = 0.75  # distance of the nearest descriptor to that of the second nearest elsewhere in the picture (Lowe 2004)
TOLERANCE = 1.5  # px at `static_scene.SIZE`; raised to six standard deviations of the error, but at most four times this
DISTINCT = 2.0  # a contradicting feature must be this many times nearer to its match than to any other feature of its own picture
ELSEWHERE = 4.0  # px; closer features are the same one at another scale
TOGETHER = 0.08  # of the picture's longest side, within which features move as one object
FEWEST_TOGETHER = 3  # chance mismatches do not agree with each other in threes


@dataclass(frozen=True)
class Features:
    """xy [N, 2] px, pixel centres at +0.5; unit [N, 128] float32: RootSIFT (Arandjelovic 2012), of norm 1."""

    xy: np.ndarray
    unit: np.ndarray


@dataclass(frozen=True)
class PairEvidence:
    """supporting: matches that one camera motion explains; moving: distinctive matches that contradict it in groups.

    displacement: median distance between matched features, px.
    """

    supporting: int
    moving: int
    displacement: float


NOTHING = PairEvidence(0, 0, 0.0)


def features(picture: np.ndarray) -> Features:
    """SIFT features of a picture uint8 [H, W, 3] RGB."""
    import cv2

    sift = cv2.SIFT.create(nfeatures=MAX_FEATURES)
    found, descriptors = sift.detectAndCompute(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), None)
    if descriptors is None or len(found) == 0:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    root = np.sqrt(descriptors / np.maximum(descriptors.sum(1, keepdims=True), 1e-9)).astype(np.float32)
    return Features(np.array([point.pt for point in found]) + 0.5, root)


def compare(first: Features, second: Features, size: float, known: TwoView | None = None) -> PairEvidence:
    """Evidence from two pictures whose longest side is `size` px; known: their geometry from poses; None estimates it from the matches.

    A match off the epipolar line is usually a repeated structure (windows, bricks), not motion. So it counts only if the feature is unlike
    everything else in its own picture, matches as well as the matches that agree, and moves together with others nearby.
    """
    if min(len(first.xy), len(second.xy)) < 2:
        return NOTHING
    i, j, distance = _matches(first, second)
    a, b = first.xy[i], second.xy[j]
    model = known if known is not None else two_view(a, b)
    if model is None or len(i) == 0:
        return NOTHING
    error = (sampson if model.kind == "epipolar" else transfer)(model.matrix, a, b)
    sigma = 1.4826 * float(np.median(error))
    agrees = error <= max(TOLERANCE, min(6.0 * sigma, 4.0 * TOLERANCE))
    displacement = float(np.median(np.hypot(*(b - a).T)))
    if agrees.sum() < 2:
        return PairEvidence(int(agrees.sum()), 0, displacement)
    against = np.flatnonzero(~agrees & (distance <= np.quantile(distance[agrees], 0.9)))
    unlike = np.minimum(_nearest_own(first, i[against]), _nearest_own(second, j[against]))
    against = against[unlike > DISTINCT * distance[against]]
    return PairEvidence(int(agrees.sum()), _together(a[against], b[against], TOGETHER * size), displacement)


def _matches(first: Features, second: Features) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Indices [M], [M] of mutual nearest neighbours that pass the ratio test, and their descriptor distance [M]."""
    cosine = first.unit @ second.unit.T
    best = cosine.argmax(1)
    rows = np.arange(len(best))
    nearest = cosine[rows, best]
    mutual = cosine.argmax(0)[best] == rows
    top = np.argpartition(cosine, -min(4, cosine.shape[1]), axis=1)[:, -4:]  # contains the second nearest elsewhere
    away = ((second.xy[top] - second.xy[best][:, None]) ** 2).sum(-1) > ELSEWHERE**2
    after = np.where(away, np.take_along_axis(cosine, top, 1), -1.0).max(1)
    keep = mutual & (_distance(nearest) < RATIO * _distance(after))
    return rows[keep], best[keep], _distance(nearest[keep])


def _nearest_own(features: Features, chosen: np.ndarray) -> np.ndarray:
    """[n] descriptor distance of each chosen feature to the nearest other feature of the same picture."""
    if len(chosen) == 0:
        return np.zeros(0)
    cosine = features.unit[chosen] @ features.unit.T
    cosine[((features.xy[chosen][:, None] - features.xy[None]) ** 2).sum(-1) <= ELSEWHERE**2] = -1.0
    return _distance(cosine.max(1))


def _together(a: np.ndarray, b: np.ndarray, reach: float) -> int:
    """How many of the moves a -> b [n, 2] have at least two others within `reach` px that move in about the same way; 0 if these are fewer
    than three, and so no group."""
    if len(a) < FEWEST_TOGETHER:
        return 0
    apart = np.linalg.norm(a[:, None] - a[None], axis=2)
    differ = np.linalg.norm((b - a)[:, None] - (b - a)[None], axis=2)
    # At least 2 px apart, so that one corner found at three scales is not a group. Displacements may differ by half the distance, since an
    # object that turns or comes closer is sheared or scaled.
    alike = (apart < reach) & (apart > 0.5 * ELSEWHERE) & (differ < 0.5 * apart + 2 * TOLERANCE)
    members = int((alike.sum(1) >= FEWEST_TOGETHER - 1).sum())
    return members if members >= FEWEST_TOGETHER else 0


def _distance(cosine: np.ndarray) -> np.ndarray:
    return np.sqrt(np.maximum(0.0, 2.0 - 2.0 * cosine))
