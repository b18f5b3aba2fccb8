"""Similarity alignment of two sets of points, with or without outliers."""

from __future__ import annotations

import numpy as np

TRIALS = 200  # samples of three pairs; if half of the pairs are wrong, every sample holds a wrong one only once in 10^11
CLOSE = 0.05  # of the median distance of the target's points from their median; pairs within this distance agree
AGREED = 20, 0.5  # least number and least share of pairs that must agree


def similarity(source: np.ndarray, target: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """`(scale, R [3,3], t [3])` that minimise sum |scale R source + t - target|^2 (Umeyama, TPAMI 1991). Both [N,3], N >= 3.

    Raises ValueError if the points lie on a line or coincide, since the rotation is then undetermined.
    """
    if source.shape != target.shape or source.ndim != 2 or source.shape[1] != 3 or len(source) < 3:
        raise ValueError(f"similarity: two arrays [N,3] with N >= 3 expected, got {source.shape} and {target.shape}")
    mean_source, mean_target = source.mean(axis=0), target.mean(axis=0)
    a, b = source - mean_source, target - mean_target
    u, values, vt = np.linalg.svd(b.T @ a / len(a))
    if values[1] <= 1e-12 * max(values[0], np.finfo(float).tiny):
        raise ValueError("similarity: the points lie on a line, the rotation about it is not determined")
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    R = u @ np.diag(signs) @ vt
    scale = float((values * signs).sum() / (a**2).sum(axis=1).mean())
    return scale, R, mean_target - scale * R @ mean_source


def robust_similarity(source: np.ndarray, target: np.ndarray, seed: int = 0) -> tuple[float, np.ndarray, np.ndarray] | None:
    """`similarity` of the pairs that agree on one, source and target [N, 3] (RANSAC; Fischler and Bolles 1981). None if fewer than 20 pairs
    or fewer than half agree. Pairs with coordinates that are not finite count as disagreeing."""
    finite = np.isfinite(source).all(axis=1) & np.isfinite(target).all(axis=1)
    a, b = source[finite], target[finite]
    least = max(AGREED[0], AGREED[1] * len(source))
    if len(a) < least:
        return None
    # medians, so that one distant point does not loosen the limit for all
    bar = CLOSE * float(np.median(np.linalg.norm(b - np.median(b, axis=0), axis=1)))
    rng = np.random.default_rng(seed)
    best = np.zeros(len(a), bool)
    for _ in range(TRIALS):
        inliers = _agreeing(a, b, rng.choice(len(a), 3, replace=False), bar)
        best = inliers if inliers.sum() > best.sum() else best
    for _ in range(2):
        if best.sum() < least:
            return None
        best = _agreeing(a, b, np.flatnonzero(best), bar)
    return similarity(a[best], b[best]) if best.sum() >= least else None


def _agreeing(source: np.ndarray, target: np.ndarray, chosen: np.ndarray, bar: float) -> np.ndarray:
    try:
        scale, R, t = similarity(source[chosen], target[chosen])
    except ValueError:
        return np.zeros(len(source), bool)
    agreeing: np.ndarray = np.linalg.norm(scale * source @ R.T + t - target, axis=1) <= bar
    return agreeing


def camera_centres(cam_from_world: np.ndarray) -> np.ndarray:
    """[N,4,4] -> [N,3]: -R^T t."""
    return -np.einsum("nji,nj->ni", cam_from_world[:, :3, :3], cam_from_world[:, :3, 3])
