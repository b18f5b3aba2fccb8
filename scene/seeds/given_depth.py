"""Depth that came with the capture, fitted to the scene's known points frame by frame.

Depth comes in every kind: metric in a world of other units (LiDAR), up to a factor, or up to a factor and a shift of depth or of inverse
depth (networks). Which of them is found from the points: a factor alone if that explains them about as well as anything else, otherwise
what explains them best. A unit in the files is thus not needed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..views import Views

FEWEST = 12  # least number of points in a frame for a fit
SIMPLER = 1.15  # a factor alone is taken if its error is at most this many times the least
STEADY = 0.02  # spread of the factors' logarithms over time below which all frames share one
PRECISE = 0.02  # error below which single pixels are believed; above it only what many of them agree on
TRIES, ROUNDS = 60, 5
POINTS = 1500  # of a frame, at most
SIZE = 480  # px

# For each kind, the columns whose weighted sum is the inverse depth (True) or the depth (False) of a pixel of value d.
Columns = Callable[[np.ndarray], np.ndarray]
SCALE = "depth up to scale"
KINDS: dict[str, tuple[Columns, bool]] = {
    SCALE: (lambda d: d[:, None], False),
    "depth up to scale and shift": (lambda d: np.stack([d, np.ones_like(d)], 1), False),
    "inverse depth up to scale and shift": (lambda d: np.stack([d, np.ones_like(d)], 1), True),
    "depth whose inverse is known up to scale and shift": (lambda d: np.stack([1 / d, np.ones_like(d)], 1), True),
}


class GivenDepth(NamedTuple):
    """kind: one of `KINDS`. error: median of how far known points are from it, as a share of their depth. z: by frame, depth [h, w] in
    world units, 0 where it is unknown. confidence: by frame, [h, w] in [0, 1]."""

    kind: str
    error: float
    z: dict[int, np.ndarray]
    confidence: dict[int, np.ndarray]

    @property
    def precise(self) -> bool:
        """Whether single pixels are to be believed."""
        return self.error < PRECISE


def fit_depth(
    maps: Callable[[int], tuple[np.ndarray, np.ndarray] | None],
    views: Views,
    frames: np.ndarray,
    points: np.ndarray,
    still: Callable[[int], np.ndarray | None] = lambda i: None,
) -> GivenDepth | None:
    """The depth of ``frames`` in world units. maps(i): values and confidence [H, W] of frame i, 0 where they are unknown, or None. points
    [P, 3]: trusted ones, at rest. still(i): [H, W] bool, where frame i shows what is at rest; None: everywhere. The result is None if no
    frame has both a map and enough points."""
    known, samples = {}, {}
    for i in (int(i) for i in frames):
        found = maps(i)
        if found is None:
            continue
        _, x, y, z = views.project(i, points)
        rest = still(i)
        value = found[0][y, x] if rest is None else np.where(rest[y, x], found[0][y, x], 0)
        if (value > 0).sum() >= FEWEST:
            step = -(-int((value > 0).sum()) // POINTS)
            known[i], samples[i] = _small(found), (value[value > 0][::step].astype(np.float64), z[value > 0][::step])
    if not known:
        return None
    fits = {kind: {i: _fit(kind, *sample) for i, sample in samples.items()} for kind in KINDS}
    errors = {kind: float(np.median([_error(kind, fit[i], *samples[i]) for i in samples])) for kind, fit in fits.items()}
    best = min(errors, key=lambda kind: errors[kind])
    kind = SCALE if errors[SCALE] <= SIMPLER * errors[best] else best
    fit = fits[kind]
    if kind == SCALE:
        factors = np.array([fit[i][0] for i in fit])
        if np.median(np.abs(np.log(factors / np.median(factors)))) < STEADY:
            fit = dict.fromkeys(fit, np.array([np.median(factors)]))
    depth, sure = {}, {}
    for i, (values, confidence) in known.items():
        depth[i] = _apply(kind, fit[i], values, float(samples[i][1].max()))
        sure[i] = np.where(depth[i] > 0, np.clip(confidence / max(float(confidence.max()), 1e-9), 0, 1), 0).astype(np.float32)
    return GivenDepth(kind, float(np.median([_error(kind, fit[i], *samples[i]) for i in samples])), depth, sure)


def scaled_depth(
    maps: Callable[[int], tuple[np.ndarray, np.ndarray] | None],
    frames: np.ndarray,
    unsteady: Callable[[int], np.ndarray | None],
    distance: float,
) -> GivenDepth | None:
    """The depth of ``frames`` of one camera that stands still, whose points nobody knows: the maps are taken as depth up to scale, and each
    is scaled to agree with the others where nothing moves, with a median of ``distance`` world units there. For the arguments, see
    `fit_depth`; unsteady(i): [H, W] bool, where frame i shows something that is not at rest. None if no frame has a map."""
    known, logs = {}, {}
    for i in (int(i) for i in frames):
        found = maps(i)
        if found is None or not (found[0] > 0).any():
            continue
        known[i], moves = _small(found), unsteady(i)
        value = known[i][0]
        rest = value > 0 if moves is None else (value > 0) & ~_small((moves, moves))[0]
        rest = rest if rest.any() else value > 0
        logs[i] = np.where(rest, np.log(np.maximum(value, 1e-9)), np.nan).astype(np.float32)
    if not known:
        return None
    usual = np.array([np.nanmedian(one) for one in logs.values()])
    stack = np.stack([one - middle for one, middle in zip(logs.values(), usual)])  # all of one size, that of the frames
    somewhere = np.isfinite(stack).any(axis=0)
    together = np.full(somewhere.shape, np.nan, np.float32)
    together[somewhere] = np.nanmedian(stack[:, somewhere], axis=0)
    together += np.log(distance) - np.nanmedian(together)
    depth, sure, errors = {}, {}, []
    for i, (values, confidence) in known.items():
        off = together - logs[i]
        factor = np.nanmedian(off)
        errors.append(float(np.nanmedian(np.abs(off - factor))))
        depth[i] = np.where(values > 0, values * np.exp(factor), 0).astype(np.float32)
        sure[i] = np.where(values > 0, np.clip(confidence / max(float(confidence.max()), 1e-9), 0, 1), 0).astype(np.float32)
    return GivenDepth(SCALE, float(np.median(errors)), depth, sure)


def _small(found: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Values and confidence with at most `SIZE` px on the longer side: those of all frames are in memory."""
    step = -(-max(found[0].shape) // SIZE)
    return found[0][step // 2 :: step, step // 2 :: step], found[1][step // 2 :: step, step // 2 :: step]


def _fit(kind: str, value: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Weights of the columns of ``kind`` for pixels of ``value`` [n] at depths ``z`` [n]. Of `TRIES` exact fits to one or two of them that
    with the least median error (Rousseeuw 1984), then least squares of relative errors, whose weights fall for pixels that do not fit."""
    columns, inverse = KINDS[kind]
    rows = columns(value) * (z if inverse else 1 / z)[:, None]
    rng = np.random.default_rng(0)
    chosen = rows[rng.integers(len(rows), size=(TRIES, rows.shape[1]))]
    tries = np.linalg.pinv(chosen) @ np.ones(rows.shape[1])
    found = tries[np.median(np.abs(rows @ tries.T - 1), axis=0).argmin()]
    for _ in range(ROUNDS):
        off = np.abs(rows @ found - 1)
        weight = 1 / np.sqrt(1 + (off / (1.5 * np.median(off) + 1e-6)) ** 2)
        found = np.linalg.lstsq(rows * weight[:, None], weight, rcond=None)[0]
    return np.asarray(found)


def _error(kind: str, fit: np.ndarray, value: np.ndarray, z: np.ndarray) -> float:
    columns, inverse = KINDS[kind]
    found = np.maximum(columns(value) @ fit, 1e-9)
    return float(np.median(np.abs(np.log(found * z if inverse else found / z))))


def _apply(kind: str, fit: np.ndarray, values: np.ndarray, farthest: float) -> np.ndarray:
    """Depth [h, w] float32; 0 where ``values`` [h, w] are unknown, and where the fit leads behind the camera or far beyond the points."""
    columns, inverse = KINDS[kind]
    z = np.zeros(values.shape, np.float32)
    there = values > 0
    found = columns(values[there].astype(np.float64)) @ fit
    found = 1 / np.maximum(found, 1e-9) if inverse else found
    z[there] = np.where((found > 0) & (found < 4 * farthest), found, 0)
    return z
