"""Aligns depth of any kind to known points, frame by frame and smoothly over time.

Depth comes in every kind: metric in a world of other units (LiDAR), up to a factor, or up to a factor and a shift of depth or of inverse
depth (networks). Which of them is found from the points: a factor alone if that explains them about as well as anything else, otherwise
what explains them best. A unit in the files is thus not needed.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from .over_time import smooth_over_time

FEWEST = 12  # least number of points in a frame for a fit
SIMPLER = 1.15  # a factor alone is taken if its error is at most this many times the least,
SURE, MATTERS = (
    3.0,
    0.05,
)  # unless a shift is this many times its standard deviation, and this share of near depths: noise hides it in errors
SMALL = 1e-3  # difference of errors that does not matter
TELLING, CLOSE = 0.7, 0.05  # depth is refused if its error is above both: times that of one depth for all points, and absolutely
STEADY = 0.02  # spread of the factors' logarithms over time below which all frames share one
TRIES, ROUNDS = 60, 5
CELLS = 3  # blocks along each side of the picture whose errors count as independent: within one, errors of depth are alike

METRIC, SCALE = "metric", "up to scale"
INVERSE = "inverse depth up to scale and shift"


class Kind(NamedTuple):
    """What a map holds: its value d, or 1 / d if ``reciprocal``, is scale * g + shift, where g is the depth z, or 1 / z if ``inverse``."""

    reciprocal: bool
    inverse: bool
    shifted: bool = True

    def of_value(self, d: np.ndarray) -> np.ndarray:
        return 1 / d if self.reciprocal else d

    def of_depth(self, z: np.ndarray) -> np.ndarray:
        return 1 / z if self.inverse else z


KINDS = {
    SCALE: Kind(False, False, shifted=False),
    "up to scale and shift": Kind(False, False),
    INVERSE: Kind(False, True),
    "up to scale and shift of the inverse": Kind(True, True),
}


class Sample(NamedTuple):
    """Known points that a frame shows: value [n] > 0 of the depth map there, and the true depth z [n] > 0, world units. place [n, 2]: where
    in the picture, each in [0, 1)."""

    value: np.ndarray
    z: np.ndarray
    place: np.ndarray


class Alignment(NamedTuple):
    """kind: `METRIC`, where all frames share one factor, or one of `KINDS`. error: median of how far known points are from the aligned
    depth, as a share of their depth. fits: by frame, scale and perhaps shift. errors: by frame, NaN where a frame has too
    few points of its own and is aligned as its neighbours are. farthest: depth of the farthest point, world units."""

    kind: str
    error: float
    fits: dict[int, np.ndarray]
    errors: dict[int, float]
    farthest: float

    def depth(self, i: int, values: np.ndarray) -> np.ndarray:
        """Depth [h, w] float32 of frame i, world units; 0 where ``values`` [h, w] are unknown (0), and where the fit leads behind the
        camera or far beyond the points."""
        kind, (scale, shift) = KINDS[SCALE if self.kind == METRIC else self.kind], (*self.fits[i], 0.0)[:2]
        z = np.zeros(values.shape, np.float32)
        there = values > 0
        found = (kind.of_value(values[there].astype(np.float64)) - shift) / scale
        found = 1 / np.maximum(found, 1e-9) if kind.inverse else found
        z[there] = np.where((found > 0) & (found < 4 * self.farthest), found, 0)
        return z


def align(samples: Mapping[int, Sample], sequences: Sequence[Sequence[int]], kinds: Collection[str] = tuple(KINDS)) -> Alignment | None:
    """Aligns the frames of ``sequences``, each of one camera in order of time, by their ``samples``. kinds: those that the depth may be of.
    None if no frame has `FEWEST` points, or if the depth has little to do with the points."""
    used = {i: sample for i, sample in samples.items() if len(sample.value) >= FEWEST}
    if not used:
        return None
    fits = {kind: {i: _fit(KINDS[kind], sample) for i, sample in used.items()} for kind in kinds}
    errors = {kind: float(np.median([_error(KINDS[kind], fit[i], used[i]) for i in used])) for kind, fit in fits.items()}
    kind = min(errors, key=lambda kind: errors[kind])
    shifted = min((one for one in kinds if KINDS[one].shifted), key=lambda one: errors[one], default=None)
    if SCALE in errors and errors[SCALE] <= SIMPLER * errors[kind] + SMALL:
        kind = shifted if shifted is not None and _has_shift(KINDS[shifted], fits[shifted], used) else SCALE
    flat = float(np.median([np.median(np.abs(np.log(one.z / np.median(one.z)))) for one in used.values()]))
    if errors[kind] > max(TELLING * flat, CLOSE):
        return None
    fit, told = {i: one for i, one in fits[kind].items() if one[0] > 0}, kind
    if kind == SCALE and _spread(np.array([one[0] for one in fit.values()])) < STEADY:
        shared = np.median([one[0] for one in fit.values()], keepdims=True)
        fit, told = {i: shared for frames in sequences for i in frames}, METRIC
    else:
        fit = _smooth(KINDS[kind], fit, used, sequences)
    each = {i: _error(KINDS[kind], fit[i], used[i]) if i in used else np.nan for i in fit}
    farthest = max(float(sample.z.max()) for sample in used.values())
    return Alignment(told, float(np.nanmedian(list(each.values()))), fit, each, farthest)


def _fit(kind: Kind, sample: Sample) -> np.ndarray:
    """Scale, and shift if there is one. Of `TRIES` exact fits to one or two points that with the least median error (Rousseeuw 1984), then
    least squares, whose weights fall for points that do not fit: so up to half of them may be wrong. Points are exact and maps are not, so
    it is the map's value that is explained by the point: the other way round, noise makes the scale too small (regression dilution)."""
    rows, wanted = _rows(kind, sample)
    rng = np.random.default_rng(0)
    chosen = rng.integers(len(rows), size=(TRIES, rows.shape[1]))
    tries = (np.linalg.pinv(rows[chosen]) @ wanted[chosen][..., None])[..., 0]
    found = tries[np.median(np.abs(rows @ tries.T - wanted[:, None]), axis=0).argmin()]
    for _ in range(ROUNDS):
        weight = np.sqrt(_trust(rows @ found - wanted))
        found = np.linalg.lstsq(rows * weight[:, None], wanted * weight, rcond=None)[0]
    return np.asarray(found)


def _rows(kind: Kind, sample: Sample) -> tuple[np.ndarray, np.ndarray]:
    """Rows [n, 1 or 2], and what their products with scale and shift should be [n]: all divided by g, as errors are relative."""
    g = kind.of_depth(sample.z)
    rows = np.stack([np.ones_like(g), 1 / g], 1) if kind.shifted else np.ones((len(g), 1))
    return rows, kind.of_value(sample.value) / g


def _trust(off: np.ndarray) -> np.ndarray:
    """Weight (Cauchy's) of points with the errors ``off``."""
    return np.asarray(1 / (1 + (off / (1.5 * np.median(np.abs(off)) + 1e-12)) ** 2))


def _error(kind: Kind, fit: np.ndarray, sample: Sample) -> float:
    """Median relative error of the depth; infinite for a fit whose scale is not positive."""
    scale, shift = (*fit, 0.0)[:2]
    if scale <= 0:
        return float("inf")
    found = (kind.of_value(sample.value) - shift) / scale
    return float(np.median(np.abs(np.log(np.maximum(found / kind.of_depth(sample.z), 1e-9)))))


def _has_shift(kind: Kind, fits: Mapping[int, np.ndarray], samples: Mapping[int, Sample]) -> bool:
    """Whether the shift of most frames is more than chance, and matters for what is nearer than most points."""
    sure, share = [], []
    for i, (scale, shift) in fits.items():
        variance = float(_covariance(kind, fits[i], samples[i])[1, 1])
        sure.append(abs(shift) / np.sqrt(max(variance, 1e-24)))
        share.append(abs(shift / scale) / float(np.quantile(kind.of_depth(samples[i].z), 0.85 if kind.inverse else 0.15)))
    return bool(np.median(sure) > SURE and np.median(share) > MATTERS)


def _spread(factors: np.ndarray) -> float:
    """Of the logarithms, infinite if a factor is not positive."""
    if (factors <= 0).any():
        return float("inf")
    return float(np.median(np.abs(np.log(factors / np.median(factors)))))


def _smooth(
    kind: Kind, fits: dict[int, np.ndarray], samples: Mapping[int, Sample], sequences: Sequence[Sequence[int]]
) -> dict[int, np.ndarray]:
    """``fits`` as smooth over time as their own uncertainty allows. What is smoothed are the values of usual depths: scale and shift
    themselves make up for one another."""
    g = kind.of_depth(np.concatenate([samples[i].z for i in fits]))
    usual = np.quantile(g, [0.15, 0.85] if kind.shifted else [0.5])
    at = np.stack([usual, np.ones_like(usual)], 1) if kind.shifted else usual[:, None]
    if np.linalg.cond(at) > 1e8:  # all points are equally far
        return fits
    values = {i: at @ fit for i, fit in fits.items()}
    doubt = {i: np.diag(at @ _covariance(kind, fits[i], samples[i]) @ at.T) for i in fits}
    smooth: dict[int, np.ndarray] = {}
    for frames in sequences:
        smooth |= smooth_over_time(frames, values, doubt, STEADY)
    return {i: np.linalg.solve(at, one) for i, one in smooth.items()}


def _covariance(kind: Kind, fit: np.ndarray, sample: Sample) -> np.ndarray:
    """Of ``fit``, if errors in different blocks of the picture are independent (White 1980, for clusters)."""
    rows, wanted = _rows(kind, sample)
    off = rows @ fit - wanted
    weighted = rows * _trust(off)[:, None]
    cell = (sample.place * CELLS).astype(int) @ [1, CELLS]
    sums = np.zeros((CELLS * CELLS, rows.shape[1]))
    np.add.at(sums, cell, weighted * off[:, None])
    count = len(np.unique(cell))
    bread = np.linalg.pinv(weighted.T @ rows)
    return np.asarray(bread @ (sums.T @ sums) @ bread * (count / max(count - 1, 1)))
