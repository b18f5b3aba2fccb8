"""Turns a residual in px into evidence of motion. The noise is measured on the residual itself; most of the picture must be static."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .residual import Neighbour, Residual, known

NOISE_FACTOR = 6.0  # standard deviations that motion must exceed; one more than for grey levels, since errors of flow have heavy tails
FLOOR = 0.05  # px; flow of 8-bit pictures is no finer, and exact flow has no noise to measure
DECADE = 3.0  # evidence of motion is full at three times the threshold, evidence of stillness at a third of it
SURE = 0.25  # least weight of pixels on which the noise is measured
BANDS = 8  # of local spread of flow
WORST = 2.0  # times the picture's noise, the most assumed in a band: a moving object may fill a band, and its motion is not noise
WINDOW = 4.0  # px, for the spread
FEWEST = 32  # pixels; fewer give no statistics


@dataclass(frozen=True)
class Evidence:
    """score [H, W] float32 in [-1, 1]: -1 static, 1 moving; weight [H, W] float32 in [0, 1]: 0 unknown; sigma: the measured noise, px."""

    score: np.ndarray
    weight: np.ndarray
    sigma: float


def evidence(residual: Residual, spread: np.ndarray) -> Evidence:
    """Scores residuals against their own noise. spread [H, W] float32: see `spread_of_flow`.

    The standard deviation is estimated by the mode of the density of the error's square root. For Gaussian errors with n redundant
    equations, the mode lies at sigma times the root of n - 1/2 (set d/dl of exp((n - 1/2) l - exp(2 l) / 2) to 0). Unlike median and MAD,
    it does not shift when a large share of the picture moves, as long as no larger group agrees on one error. Flow is less accurate
    beside depth edges, so pixels are split into bands of equal size by local spread, and each band's lower quartile raises its threshold,
    by a factor of at most `WORST`.
    """
    error, weight = residual.error, residual.weight
    sure = weight > SURE
    if np.count_nonzero(sure) < FEWEST:
        return Evidence(np.zeros_like(error), np.zeros_like(weight), 0.0)
    log = np.log(np.maximum(error, 1e-6))
    sigma = max(FLOOR, float(np.exp(_mode(log[sure]))))
    threshold = np.log(NOISE_FACTOR * sigma) + _shifts(log, sure, spread)
    score = np.clip((log - threshold) / np.log(DECADE), -1.0, 1.0)
    return Evidence(score.astype(np.float32), weight, sigma)


def _mode(log: np.ndarray) -> float:
    """The mode of log errors: the highest bin of a histogram smoothed over 0.15, with densities taken per square root of the error.

    On the log axis, a rigid moving object, whose pixels all have about the same error, would give a higher peak than a larger static part
    whose errors spread over a decade. On the axis of the error itself, the density for one equation peaks only at zero. Between the two,
    the mode for n equations lies at sigma times the root of n - 1/2, and of groups equally dense in log the one with less error wins.
    """
    import cv2

    low, high, bins = np.log(FLOOR / 50), np.log(1e3), 512
    counts, edges = np.histogram(np.clip(log, low, high), bins, (low, high))
    smooth = cv2.GaussianBlur(counts.astype(np.float32)[None], (0, 0), 0.15 / (edges[1] - edges[0]), borderType=cv2.BORDER_CONSTANT)[0]
    centres = 0.5 * (edges[1:] + edges[:-1])
    return float(centres[int((smooth * np.exp(-0.5 * np.maximum(centres, np.log(FLOOR)))).argmax())])


def _shifts(log: np.ndarray, sure: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """[H, W] added to the log threshold, in [0, log WORST]."""
    if np.count_nonzero(sure) < FEWEST * BANDS:
        return np.zeros_like(log)
    inside = spread[sure]
    limits = np.quantile(inside, np.linspace(0, 1, BANDS + 1)[1:-1])
    band, band_of_sure = np.searchsorted(limits, spread), np.searchsorted(limits, inside)
    values, overall = log[sure], np.quantile(log[sure], 0.25)
    shift = np.zeros(BANDS, np.float32)
    for b in range(BANDS):
        mine = values[band_of_sure == b]
        if len(mine) >= FEWEST:
            shift[b] = np.clip(np.quantile(mine, 0.25) - overall, 0.0, np.log(WORST))
    return shift[band]


def spread_of_flow(neighbours: Sequence[Neighbour]) -> np.ndarray:
    """[H, W] float32 px: standard deviation of the flow within `WINDOW` px, over the neighbours; large beside edges of depth."""
    import cv2

    total = 0.0
    for one in neighbours:
        flow, _ = known(one)
        flow = flow - flow.mean((0, 1))  # so that float32 does not lose the difference of two large squares
        mean = cv2.GaussianBlur(flow, (0, 0), WINDOW, borderType=cv2.BORDER_REPLICATE)
        square = cv2.GaussianBlur(flow * flow, (0, 0), WINDOW, borderType=cv2.BORDER_REPLICATE)
        variance = np.maximum(square - mean * mean, 0)
        total = total + (variance[..., 0] + variance[..., 1])
    return np.sqrt(total / len(neighbours)).astype(np.float32)
