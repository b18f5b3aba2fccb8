"""Camera motion between two views from matches: a fundamental matrix or a homography, whichever explains them more simply."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from .residual import Neighbour, Residual, checked, known

SAMPLES = 1500  # matches used to estimate the geometry; more only take longer
FEWEST = 24  # matches; three times what a fundamental matrix needs, since fewer always fit some geometry
FINEST = 0.1  # px, the smallest width of robust weights
CONFIDENT = 0.5  # least weight of flow that takes part in the estimate


@dataclass(frozen=True)
class TwoView:
    """matrix [3, 3]: x2^T F x1 = 0 ("epipolar") or x2 ~ H x1 ("homography", a camera that turns or a flat scene)."""

    kind: Literal["epipolar", "homography"]
    matrix: np.ndarray


def two_view(first: np.ndarray, second: np.ndarray, scale: float = 1.0) -> TwoView | None:
    """Geometry of matches first, second [N, 2] px by MAGSAC++ (Barath et al. 2020, in OpenCV); None if nothing fits.

    scale: the largest matching error expected, px. The criterion GRIC chooses between the models (Torr 1998: matches have r = 4
    dimensions; a homography leaves d = 2 and has k = 8 parameters, a fundamental matrix d = 3 and k = 7). Deterministic.
    """
    if len(first) < FEWEST:
        return None
    a, b = np.ascontiguousarray(first, np.float64), np.ascontiguousarray(second, np.float64)
    errors: list[tuple[TwoView, np.ndarray, int, int]] = []
    F, H = _fundamental(a, b, scale), _homography(a, b, scale)
    if F is not None:
        errors.append((TwoView("epipolar", F), sampson(F, a, b), 3, 7))
    if H is not None:
        errors.append((TwoView("homography", H), transfer(H, a, b), 2, 8))
    if not errors:
        return None
    # both models get one noise level, that of the better fit, since GRIC compares explanations of the same measurements
    sigma = max(FINEST / 2, min(1.4826 * float(np.median(error)) for _, error, _, _ in errors))
    found = []
    for model, residual, d, k in errors:
        capped = np.minimum(np.square(residual / sigma), 2.0 * (4 - d))
        found.append((float(capped.sum() + np.log(4.0) * d * len(a) + np.log(4.0 * len(a)) * k), model))
    return min(found, key=lambda entry: entry[0])[1]


def _fundamental(a: np.ndarray, b: np.ndarray, limit: float) -> np.ndarray | None:
    """The fundamental matrix with the least median error among MAGSAC++'s and its refinements."""
    import cv2

    try:
        F, _ = cv2.findFundamentalMat(a, b, cv2.USAC_MAGSAC, limit, 0.999, 2000)
    except cv2.error:  # all matches at one point or on one line
        F = None
    starts = [None] if F is None or F.shape != (3, 3) or not np.isfinite(F).all() else [F, None]
    refined = [R for R in (_refined(start, a, b, limit) for start in starts) if R is not None]
    found = [start for start in starts if start is not None] + refined
    return min(found, key=lambda one: float(np.median(sampson(one, a, b))), default=None)


def _refined(F: np.ndarray | None, a: np.ndarray, b: np.ndarray, limit: float) -> np.ndarray | None:
    """Refines F by reweighted least squares on all matches (eight-point with Hartley's scaling, Sampson's and Geman-McClure's weights).

    The robust scale starts wide and shrinks towards the noise, so that moving matches lose influence step by step (graduated
    non-convexity, Blake and Zisserman 1987). Minimal samples cannot do this if parallax is hardly larger than noise. F None: starts with
    equal weights.
    """
    centre_a, centre_b = a.mean(0), b.mean(0)
    size_a, size_b = a.std() + 1e-9, b.std() + 1e-9
    p, q = (a - centre_a) / size_a, (b - centre_b) / size_b
    rows = np.column_stack([q[:, :1] * p, q[:, 0], q[:, 1:] * p, q[:, 1], p, np.ones(len(p))])
    Ta = np.array([[1 / size_a, 0, -centre_a[0] / size_a], [0, 1 / size_a, -centre_a[1] / size_a], [0, 0, 1.0]])
    Tb = np.array([[1 / size_b, 0, -centre_b[0] / size_b], [0, 1 / size_b, -centre_b[1] / size_b], [0, 0, 1.0]])
    weight = np.ones(len(a))
    if F is not None:
        weight = _weights(F, a, b, limit)
    width, settled = (limit if F is not None else 8.0 * limit), 0
    for _ in range(24):
        vectors = np.linalg.eigh((rows * weight[:, None]).T @ rows)[1]
        u, d, vt = np.linalg.svd(vectors[:, 0].reshape(3, 3))
        F = Tb.T @ (u @ np.diag([d[0], d[1], 0.0]) @ vt) @ Ta
        F = F / np.linalg.norm(F)
        if not np.isfinite(F).all():
            return None
        finest = max(FINEST, 3.0 * 1.4826 * float(np.median(sampson(F, a, b))))
        narrower = max(min(width, finest), 0.7 * width, FINEST)
        settled, width = settled + 1 if narrower > 0.95 * width else 0, narrower
        if settled == 4:
            break
        weight = _weights(F, a, b, width)
    return F


def _weights(F: np.ndarray, a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """Weights [N] of squared algebraic errors: Sampson's, which convert them to px, times Geman and McClure's of `width` px."""
    x, y = np.column_stack([a, np.ones(len(a))]), np.column_stack([b, np.ones(len(b))])
    left, right = (x @ F.T)[:, :2], (y @ F)[:, :2]
    slope = np.maximum((left**2).sum(1) + (right**2).sum(1), 1e-24)
    squared = np.square((y * (x @ F.T)).sum(1)) / slope
    weight = 1.0 / (slope * np.square(1.0 + squared / width**2))
    return weight / weight.max()


def _homography(a: np.ndarray, b: np.ndarray, limit: float) -> np.ndarray | None:
    import cv2

    try:
        H, _ = cv2.findHomography(a, b, cv2.USAC_MAGSAC, limit, None, 2000, 0.999)
    except cv2.error:
        return None
    return H if H is not None and H.shape == (3, 3) and np.isfinite(H).all() else None


def sampson(F: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Sampson distance [...] px of matches [..., 2] from x2^T F x1 = 0: to first order, their distance from exact matches.

    Sampson 1982; Hartley and Zisserman eq. 11.9. If both points are one px off the epipolar line, its square is half a px^2.
    """
    a, b, c = (F[i, 0] * first[..., 0] + F[i, 1] * first[..., 1] + F[i, 2] for i in range(3))
    p, q = (F[0, i] * second[..., 0] + F[1, i] * second[..., 1] + F[2, i] for i in range(2))
    algebraic = second[..., 0] * a + second[..., 1] * b + c
    return np.abs(algebraic) / np.sqrt(np.maximum(a * a + b * b + p * p + q * q, 1e-24))


def transfer(H: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Distance [...] px in the second view of matches [..., 2] from H x1; infinite where H sends a point behind the camera."""
    x, y, w = (H[i, 0] * first[..., 0] + H[i, 1] * first[..., 1] + H[i, 2] for i in range(3))
    before = w * np.sign(H[2, 2] or 1.0) > 1e-9
    safe = np.where(before, w, 1.0)
    return np.where(before, np.hypot(x / safe - second[..., 0], y / safe - second[..., 1]), np.inf)


def epipolar_residual(neighbours: Sequence[Neighbour]) -> Residual:
    """Like `residual.rigid_residual`, but without poses: the distance of the flow from each pair's own geometry, see `two_view`.

    Motion along epipolar lines is not seen. A neighbour whose geometry cannot be found counts as unknown.
    Raises ValueError for other shapes.
    """
    height, width = checked(neighbours)
    first = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), -1)
    squares, total = np.zeros((height, width)), np.zeros((height, width), np.float32)
    for one in neighbours:
        model = two_view(*match_grid(one))
        if model is None:
            continue
        flow, weight = known(one)
        distance = (sampson if model.kind == "epipolar" else transfer)(model.matrix, first, first + flow)
        squares += weight * np.square(np.minimum(distance, 1e6))
        total += weight
    error = np.sqrt(squares / np.maximum(total, 1e-6)).astype(np.float32)
    return Residual(error, total * np.float32(1 / len(neighbours)))


def match_grid(neighbour: Neighbour) -> tuple[np.ndarray, np.ndarray]:
    """Pixel centres and where the flow takes them, [N, 2] float64 px each: a regular grid of about `SAMPLES` confident pixels."""
    flow, weight = known(neighbour)
    rows, columns = np.nonzero(weight >= CONFIDENT)
    step = max(1, int(np.sqrt(len(rows) / SAMPLES)))
    on = (rows % step == 0) & (columns % step == 0)
    first = np.column_stack([columns[on], rows[on]]) + 0.5
    return first, first + flow[rows[on], columns[on]]
