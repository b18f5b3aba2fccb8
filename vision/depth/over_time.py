"""Smooths what was estimated frame by frame, as far as the estimates' own uncertainty explains their changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.linalg import solveh_banded

SIDE, SURE = 3, 3.0  # frames on each side of a larger step, and how many standard deviations it has at least
LEAST = 1e-4  # of the usual size: change from frame to frame that is always allowed
DOUBT = 6.0  # variances are estimated from a few blocks of the picture and are too small; values that jump differ by far more
FAR = 8  # frames
LEAST_WALK, ROUNDS = 0.003, 3  # of what is steadied: least variance of a step, as a share of that of its noise, so that it may drift
SMALL = 0.01  # least deviation that may be an outlier's; what is steadied are logarithms
NORMAL = 1.4826  # ratio of the standard deviation of normal numbers to their median absolute value


def smooth_over_time(
    frames: Sequence[int], estimates: Mapping[int, np.ndarray], variances: Mapping[int, np.ndarray], steady: float
) -> dict[int, np.ndarray]:
    """The most likely course of a random walk through ``estimates`` [k] of some of the ``frames``, which are in order of time, with their
    ``variances`` [k]; each of the k numbers has a course of its own. How far the walk goes in a frame is what the differences of frames
    have beyond their variances; a single larger step is kept. Frames without an estimate get one if neighbours differ by less than
    ``steady`` of their size."""
    known = [i for i in frames if i in estimates]
    if not known:
        return {}
    found, varying = [], False
    for j in range(len(estimates[known[0]])):
        value, variance = (np.array([of[i][j] for i in known]) for of in (estimates, variances))
        usual = float(np.median(np.abs(value))) + 1e-12
        gap = np.diff([frames.index(i) for i in known])
        step = _step(value, variance, gap, LEAST * usual)
        varying |= bool(step > (steady * usual) ** 2)
        found.append(_course(value, variance + (LEAST * usual) ** 2, gap, step))
    courses = np.stack(found, 1)
    if varying:
        return dict(zip(known, courses, strict=True))
    place = [frames.index(i) for i in known]
    between = np.stack([np.interp(np.arange(len(frames)), place, course) for course in courses.T], 1)
    return dict(zip(frames, between, strict=True))


def steadied(frames: Sequence[int], values: Sequence[float]) -> np.ndarray:
    """[n], ``values`` [n], logarithms, of ``frames`` in order of time as a random walk that is seen with noise: as smooth as they say that
    it is. What noise adds to a change is taken back by the next one, so changes that follow one another tell how much of them is noise
    (Harvey 1989, local level model). Outliers have little weight (Cauchy's)."""
    value, gap = np.asarray(values, np.float64), np.diff(frames)
    course = np.array([np.median(value[max(0, k - SIDE) : k + SIDE + 1]) for k in range(len(value))])
    together = (gap[1:] == 1) & (gap[:-1] == 1)
    if together.sum() < FAR:
        return course
    for _ in range(ROUNDS):
        off = value - course
        usual = max(NORMAL * float(np.median(np.abs(off))), SMALL)
        change = np.diff(course + np.clip(off, -SURE * usual, SURE * usual))
        noise = max(-float(np.mean((change[1:] * change[:-1])[together])), 1e-12)
        walk = max(float(np.mean((change**2 - 2 * noise) / gap)), noise * LEAST_WALK)
        course = _course(value, noise * (1 + (off / (2 * usual)) ** 2), gap, walk)
    return course


def _step(value: np.ndarray, variance: np.ndarray, gap: np.ndarray, least: float) -> float:
    """Variance of the walk's step from a frame to the next: what neighbours differ by beyond `DOUBT` times their variances, or else by how
    much more frames differ that are farther apart. gap: frames between neighbours."""

    def differs(lag: int) -> float:
        return float((NORMAL * np.median(np.abs(value[lag:] - value[:-lag]))) ** 2)

    if len(value) < 2:
        return least**2
    lag = max(1, min(FAR, len(value) // 2))
    beyond = differs(1) - DOUBT * float(np.median(variance[1:] + variance[:-1]))
    walked = (differs(lag) - differs(1)) / (lag - 1) if lag > 1 else 0.0
    return max(beyond / float(np.median(gap)), walked / float(np.median(gap)), least**2)


def _course(value: np.ndarray, variance: np.ndarray, gap: np.ndarray, step: float) -> np.ndarray:
    """Least squares of (course - value) / variance and of the steps, of which a larger one may be where medians on both sides differ."""
    if len(value) == 1:
        return value
    beside = (
        np.array([np.median(value[max(0, k + 1 - SIDE) : k + 1]) - np.median(value[k + 1 : k + 1 + SIDE]) for k in range(len(gap))]) ** 2
    )
    usual = SIDE * step * gap + variance[1:] + variance[:-1]
    link = 1 / np.where(beside > SURE**2 * usual, beside, step * gap)
    banded = np.zeros((2, len(value)))
    banded[1] = 1 / variance
    banded[1, 1:] += link
    banded[1, :-1] += link
    banded[0, 1:] = -link
    return np.asarray(solveh_banded(banded, value / variance))
