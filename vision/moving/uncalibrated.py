"""The residual of `residual` without known poses: fits projective cameras of all neighbours jointly to their flow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .residual import Neighbour, Residual, checked, known, static_point_residual
from .two_view import FINEST, TwoView, epipolar_residual, match_grid, sampson, two_view

ROUNDS = 6  # of refitting cameras and depths in turn; after that the fit changes by less than its noise
OUTLIER = 3.0  # standard deviations at which a match has lost three quarters of its weight (Geman and McClure)
STARTS = 3  # pairs whose geometry is tried as the common projective frame
FEWEST = 48  # matches needed between the base's grid and a neighbour
View = tuple[np.ndarray, np.ndarray]


def uncalibrated_residual(neighbours: Sequence[Neighbour]) -> Residual:
    """Like `rigid_residual`, but from flow alone. It does not read intrinsics or poses.

    x' ~ H x + r e holds in any projective frame. H is the homography of some plane, and r, shared by all neighbours, is the parallax
    relative to it (Hartley and Zisserman, result 13.1 and section 18.6). One neighbour's fundamental matrix fixes the frame, and H and e of
    the others are linear in their matches. Cameras and r are then refitted in turn with robust weights. With two or more neighbours, even
    motion along epipolar lines shows if it is inconsistent with a static point. Falls back to `epipolar_residual` with one neighbour,
    without parallax (a camera that turns, a flat scene), and when the fit fails. Raises ValueError for other shapes.
    """
    checked(neighbours)
    grids = [match_grid(one) for one in neighbours]
    if len(neighbours) < 2:
        return epipolar_residual(neighbours)
    starts: list[tuple[float, int, View]] = []
    for k, (first, second) in enumerate(grids):
        model = two_view(first, second)
        if model is not None and model.kind == "epipolar":
            view = _plane_and_epipole(model, first, second)
            if view is not None:
                noise = max(FINEST, float(np.median(sampson(model.matrix, first, second))))
                starts.append((_parallax(view, first, second) / noise, k, view))
    starts.sort(key=lambda start: -start[0])
    # motion can pass as parallax in one pair but not in all, so the frames that several pairs suggest are tried
    fits = [_together(neighbours, grids[base][0], base, view) for _, base, view in starts[:STARTS]]
    best = min((fit for fit in fits if fit is not None), key=lambda fit: fit[0], default=None)
    if best is None:
        return epipolar_residual(neighbours)
    return static_point_residual(best[1], neighbours, bounded=False)


def _plane_and_epipole(model: TwoView, first: np.ndarray, second: np.ndarray) -> View | None:
    """H and e of F: H = [e']x F + e' v^T (Hartley and Zisserman, result 9.14), with v of the plane that fits the matches best."""
    u, _, _ = np.linalg.svd(model.matrix)
    e = u[:, 2]
    cross = np.array([[0.0, -e[2], e[1]], [e[2], 0.0, -e[0]], [-e[1], e[0], 0.0]])
    H = cross @ model.matrix
    H, e = H / np.linalg.norm(H), e / np.linalg.norm(e)
    x = np.column_stack([first, np.ones(len(first))])
    a, b = _equations((H, e), x, second)
    weight = np.ones(len(x))
    v = np.zeros(3)
    for _ in range(ROUNDS):
        # b - (v x) a = 0 in both coordinates, for a plane of the scene
        rows = (a[:, :, None] * x[:, None, :]).reshape(-1, 3)
        scale = np.abs(x[:, 0]).max()
        v = np.linalg.lstsq(rows / [scale, scale, 1.0] * np.repeat(weight, 2)[:, None], b.reshape(-1) * np.repeat(weight, 2), rcond=None)[0]
        v = v / [scale, scale, 1.0]
        z = x @ (H[2] + e[2] * v)
        weight = _robust(np.linalg.norm(b - (x @ v)[:, None] * a, axis=1) / np.maximum(np.abs(z), 1e-12)) / np.maximum(np.abs(z), 1e-12)
    H = H + np.outer(e, v)
    middle = float(np.median(x @ H[2]))
    if not np.isfinite(H).all() or abs(middle) < 1e-12:
        return None
    return H / middle, e / middle


def _together(neighbours: Sequence[Neighbour], first: np.ndarray, base: int, view: View) -> tuple[float, list[View]] | None:
    """Median error in px and the views of all neighbours in the base's projective frame. first [N, 2]: pixels of the base's grid."""
    x = np.column_stack([first, np.ones(len(first))])
    rows, columns = (first[:, 1] - 0.5).astype(int), (first[:, 0] - 0.5).astype(int)
    seconds, weights = [], []
    for one in neighbours:
        flow, weight = known(one)
        seconds.append(first + flow[rows, columns])
        weights.append(weight[rows, columns].astype(np.float64))
    r, error = _depths([view], x, [seconds[base]], [weights[base]])
    views: list[View] = [view] * len(neighbours)
    for turn in range(ROUNDS):
        trust = _robust(error)
        for k in range(len(neighbours)):
            if turn > 0 or k != base:
                fitted = _resect(x, r, seconds[k], weights[k] * trust)
                if fitted is None:
                    return None
                views[k] = fitted
        r, error = _depths(views, x, seconds, weights)
    return float(np.median(error)), views


def _equations(view: View, x: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """a, b [N, 2] such that b - r a = 0 for exact matches."""
    H, e = view
    hx = x @ H.T
    return second * e[2] - e[:2], hx[:, :2] - second * hx[:, 2:]


def _depths(views: Sequence[View], x: np.ndarray, seconds: Sequence[np.ndarray], weights: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
    """r [N] by least squares over the views, and the remaining error, [N] px."""
    r = np.zeros(len(x))
    for _ in range(2):
        above, below = np.zeros(len(x)), np.full(len(x), 1e-30)
        for view, second, weight in zip(views, seconds, weights):
            a, b = _equations(view, x, second)
            w = weight / np.square(np.maximum(x @ view[0][2] + r * view[1][2], 1e-3))
            above += w * (a * b).sum(1)
            below += w * (a * a).sum(1)
        r = above / below
    squares, total = np.zeros(len(x)), np.full(len(x), 1e-9)
    for view, second, weight in zip(views, seconds, weights):
        a, b = _equations(view, x, second)
        z = np.maximum(x @ view[0][2] + r * view[1][2], 1e-3)
        squares += weight * np.square((b - r[:, None] * a) / z[:, None]).sum(1)
        total += weight
    return r, np.sqrt(squares / total)


def _resect(x: np.ndarray, r: np.ndarray, second: np.ndarray, weight: np.ndarray) -> View | None:
    """H and e (12 numbers) of a view by the linear method, from x, r and their positions `second`; coordinates scaled to about one."""
    if np.count_nonzero(weight > 0.1) < FEWEST:
        return None
    size = np.abs(x).max()
    scale_r = np.median(np.abs(r)) * 1.5 + 1e-30
    points = np.column_stack([x[:, :2] / size, x[:, 2], r / scale_r])
    q = second / size
    zero = np.zeros_like(points)
    depth, solution = np.ones(len(x)), np.zeros(12)
    for _ in range(2):
        w = (np.sqrt(weight) / depth)[:, None]
        rows = np.concatenate([np.hstack([points, zero, -q[:, :1] * points]) * w, np.hstack([zero, points, -q[:, 1:] * points]) * w])
        values, vectors = np.linalg.eigh(rows.T @ rows)
        solution = vectors[:, 0]
        if values[1] < 1e-12 * values[-1]:  # more than one camera fits
            return None
        z = points @ solution[8:]
        solution = solution * np.sign(np.median(z) or 1.0)
        depth = np.maximum(np.abs(z) / np.median(np.abs(z)), 0.05)
    P = solution.reshape(3, 4)
    P = np.diag([size, size, 1.0]) @ P @ np.diag([1 / size, 1 / size, 1.0, 1 / scale_r])
    middle = float(np.median(x @ P[2, :3] + r * P[2, 3]))
    if not np.isfinite(P).all() or middle <= 0:
        return None
    P = P / middle
    return P[:, :3], P[:, 3]


def _robust(error: np.ndarray) -> np.ndarray:
    """Weights in (0, 1], relative to the scale of the errors themselves."""
    sigma = max(0.02, 1.4826 * float(np.median(error)))
    return 1.0 / np.square(1.0 + np.square(error / (OUTLIER * sigma)))


def _parallax(view: View, first: np.ndarray, second: np.ndarray) -> float:
    """Median distance in px of matches from the plane's homography, which measures how well the pair determines depth."""
    x = np.column_stack([first, np.ones(len(first))]) @ view[0].T
    return float(np.median(np.linalg.norm(x[:, :2] / x[:, 2:] - second, axis=1)))
