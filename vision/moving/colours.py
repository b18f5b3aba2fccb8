"""Which colours of a fixed camera move. This shows that the static half of a moving object belongs to the same object."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

BITS = 6  # per channel; a cell is 4 grey levels wide, about a camera's noise
SHARE = 0.02  # least ratio of changing to static pixels that is assumed: a colour counts only if its own ratio is higher
PRIOR = 1.0  # pixels of the usual mixture that every colour is assumed to have shown, since one seen once or twice says little
LIMIT = 2.0  # of the log odds, about 7 to 1: colour alone is never more certain, since the background may have the same colour


def colour_odds(pictures: Sequence[np.ndarray], changed: Sequence[np.ndarray]) -> np.ndarray:
    """Log odds that a colour is moving rather than static, float32 [64 * 64 * 64] in [-LIMIT, LIMIT]; 0 for a colour that moves as usual.

    pictures: uint8 [H, W, 3], changed: bool [H, W], of the same camera over time. As in Jones and Rehg 2002, there are two histograms, of
    the pixels that change and of those that do not, each divided by its number of pixels and smoothed by a cell in each direction. A shirt
    whose outline moves changes in a fifth of its pixels, say, and a wall in a hundredth, although most pixels of both are static.
    """
    cells = 1 << 3 * BITS
    moving, static = np.zeros(cells), np.zeros(cells)
    for picture, change in zip(pictures, changed, strict=True):
        cell = _cells(picture)
        moving += np.bincount(cell[change], minlength=cells)
        static += np.bincount(cell[~change], minlength=cells)
    share = max(SHARE, moving.sum() / max(1.0, static.sum()))
    odds = (_spread(moving) / share + PRIOR) / (_spread(static) + PRIOR)
    return np.clip(np.log(odds), -LIMIT, LIMIT).astype(np.float32)


def odds_at(odds: np.ndarray, picture: np.ndarray) -> np.ndarray:
    """Entries of `colour_odds` for the pixels of a picture, uint8 [H, W, 3]: float32 [H, W]."""
    return np.asarray(odds[_cells(picture)])


def _cells(picture: np.ndarray) -> np.ndarray:
    red, green, blue = (picture[..., k].astype(np.int32) >> 8 - BITS for k in range(3))
    return (red << 2 * BITS) | (green << BITS) | blue


def _spread(counts: np.ndarray) -> np.ndarray:
    """Smooths by 1/4 1/2 1/4 along each channel, a standard deviation of 0.7 cells."""
    side = 1 << BITS
    cube = counts.reshape(side, side, side)
    for axis in range(3):
        wide = np.pad(cube, [(1, 1) if k == axis else (0, 0) for k in range(3)])
        before, here, after = (np.take(wide, range(shift, shift + side), axis) for shift in range(3))
        cube = 0.25 * before + 0.5 * here + 0.25 * after
    return cube.ravel()
