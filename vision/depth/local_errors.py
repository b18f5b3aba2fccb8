"""What is wrong with aligned depth in parts of a picture, from the known points there.

A network's depth is off by several percent, by much the same amount at neighbouring pixels, and by another one in the next frame. So the
known points around a pixel tell how far off it is. How far errors reach is found from the points themselves: with errors that are alike
nowhere, nothing changes. This is ordinary Gaussian process regression (Rasmussen and Williams 2006, Algorithm 2.1 and Eq. 5.12).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import cv2
import numpy as np
from scipy.linalg import cho_factor, cho_solve

REACHES = (0.03, 0.06, 0.12, 0.25, 0.5)  # of the picture's width, over which errors may be alike
SHARES = (0.3, 0.6, 0.8, 0.9, 0.97)  # of the variance, that which neighbours may share
MOST, LEARNED = 300, 12  # known points of a frame, and frames from which reach and share are found
LEAST = 10.0  # difference of logarithms of the likelihood below which errors count as alike nowhere
FAR = 3 * 1.4826  # median absolute errors beyond which a point says no more than at this distance: it may be wrong itself
NODES = 4  # places for each reach at which a correction is computed; between them it is interpolated


class Errors(NamedTuple):
    """Of a frame's known points: place [n, 2], in units of the picture's width; log [n], the logarithm of true / given depth."""

    place: np.ndarray
    log: np.ndarray


class Alike(NamedTuple):
    """reach: of the picture's width. share: of the variance of the errors, that of what neighbours have in common (Matern, 3/2)."""

    reach: float
    share: float

    def covariance(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """[n, m] between places ``a`` [n, 2] and ``b`` [m, 2] for a variance of 1, without what each point has for itself."""
        distance = np.sqrt(3) / self.reach * np.linalg.norm(a[:, None] - b[None], axis=-1)
        return np.asarray(self.share * (1 + distance) * np.exp(-distance))

    def factor(self, place: np.ndarray) -> tuple[np.ndarray, bool]:
        """Of the covariance of errors at ``place`` [n, 2], see `scipy.linalg.cho_factor`."""
        found: tuple[np.ndarray, bool] = cho_factor(self.covariance(place, place) + (1 - self.share) * np.eye(len(place)), lower=True)
        return found


def errors_of(place: np.ndarray, log: np.ndarray) -> Errors:
    """At most `MOST` of the errors ``log`` [n] at ``place`` [n, 2], none farther out than `FAR`."""
    chosen = slice(None, None, max(1, -(-len(log) // MOST)))
    most = FAR * float(np.median(np.abs(log))) if len(log) else 0.0
    return Errors(place[chosen], np.clip(log[chosen], -most, most))


def how_alike(errors: Mapping[int, Errors]) -> Alike | None:
    """Reach and share that make the ``errors`` of the frames most likely; None if they are alike nowhere."""
    known = [one for one in errors.values() if len(one.log) > 1 and np.any(one.log)]
    chosen = known[:: max(1, -(-len(known) // LEARNED))]
    alone = sum(_log_likelihood(None, one) for one in chosen)
    found = {alike: sum(_log_likelihood(alike, one) for one in chosen) for alike in (Alike(r, s) for r in REACHES for s in SHARES)}
    best = max(found, key=lambda alike: found[alike])
    return best if found[best] > alone + LEAST else None


def correction(alike: Alike, errors: Errors, shape: tuple[int, int]) -> np.ndarray:
    """[h, w] float32, factor for each pixel of a map of ``shape``."""
    height, width = shape
    if not len(errors.log):
        return np.ones(shape, np.float32)
    step = max(1, int(alike.reach * width / NODES))
    rows, columns = -(-height // step), -(-width // step)
    y, x = ((np.arange(n) + 0.5) * of / n / width for n, of in ((rows, height), (columns, width)))
    nodes = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    weights = cho_solve(alike.factor(errors.place), errors.log)
    log = (alike.covariance(nodes, errors.place) @ weights).reshape(rows, columns)
    return np.exp(cv2.resize(log.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR))


def left(alike: Alike, errors: Errors) -> float:
    """Median of what is left of each point's error after a correction by all others."""
    inverse = cho_solve(alike.factor(errors.place), np.eye(len(errors.log)))
    return float(np.median(np.abs(inverse @ errors.log / np.diag(inverse))))


def _log_likelihood(alike: Alike | None, errors: Errors) -> float:
    """Of the ``errors``, up to a constant, with the variance that makes them most likely; None: independent of one another."""
    count = len(errors.log)
    if alike is None:
        return float(-count / 2 * np.log(np.mean(errors.log**2)))
    factor = alike.factor(errors.place)
    fits = errors.log @ cho_solve(factor, errors.log) / count
    return float(-count / 2 * np.log(fits) - np.log(np.diag(factor[0])).sum())
