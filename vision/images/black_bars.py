"""Finds black bars: what fills a frame around pictures of another shape, in films, screen recordings and upright videos in wide frames."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

DARK = 24.0  # levels, most of the brightest channel of a bar; black of limited range that is read as full range is 16
EVEN = 8.0  # levels, most by which a bar's pixels differ in one picture
NEARLY_ALL = (1.0, 99.0)  # percent of a line's pixels between which they are judged: compression leaves single ones
FULL = 0.6  # of a line beside a bar, least share that is at some time brighter than a bar: black behind an object ends at its outline
LEAST = 0.01  # of the height or width, for one bar
ALIKE = 0.25  # largest difference of the two bars, as a share of the larger; a dark sky has no counterpart
REACH = 20  # px from a bar to the first line that is bright: compression smears the colours of its edge over a block of 16
BLUR = 2  # px beside a bar that compression darkens


class Bars(NamedTuple):
    """How many lines of pixels are black at each side, px, with `BLUR` more that it dims."""

    left: int
    top: int
    right: int
    bottom: int

    def covered(self, height: int, width: int) -> np.ndarray:
        """[H, W] bool, the pixels of bars."""
        result = np.ones((height, width), bool)
        result[self.top : height - self.bottom, self.left : width - self.right] = False
        return result


class BarFinder:
    """``add`` every picture, then ask for ``found``."""

    def __init__(self) -> None:
        self._brightest: np.ndarray | None = None
        self._black: list[np.ndarray] = []  # for lines and columns: whether each is black in all pictures

    def add(self, picture: np.ndarray) -> np.ndarray:
        """picture: uint8 [H, W, 3], all of one size. Returns it."""
        light = picture.max(-1)
        black = [_black(light), _black(light.T)]
        if self._brightest is None:
            self._brightest, self._black = light, black
        else:
            self._brightest = np.maximum(self._brightest, light)
            self._black = [a & b for a, b in zip(self._black, black, strict=True)]
        return picture

    @property
    def found(self) -> Bars | None:
        """None if there are none."""
        if self._brightest is None:
            return None
        rows, columns = self._black
        top, bottom = _pair(rows, self._brightest[:, ~columns])
        left, right = _pair(columns, self._brightest[~rows].T)
        return Bars(left, top, right, bottom) if top or left else None


def _black(light: np.ndarray) -> np.ndarray:
    """[lines] bool: which lines of ``light`` [lines, pixels] are black."""
    low, high = np.percentile(light, NEARLY_ALL, axis=1)
    return np.asarray((high <= DARK) & (high - low <= EVEN))


def _pair(black: np.ndarray, brightest: np.ndarray) -> tuple[int, int]:
    """The heights of the bars before and after the other lines, 0 and 0 if there are none. black: which lines are. brightest: [lines,
    pixels], those pixels of each line that are not black in all lines."""
    others = np.flatnonzero(~black)
    if not len(others):
        return 0, 0
    sizes = _end(brightest, int(others[0])), _end(brightest[::-1], len(black) - 1 - int(others[-1]))
    if sizes[0] is None or sizes[1] is None:
        return 0, 0
    smaller, larger = sorted((sizes[0], sizes[1]))
    if smaller < max(1.0, LEAST * len(black)) or larger - smaller > max(BLUR, ALIKE * larger):
        return 0, 0
    return sizes[0] + BLUR, sizes[1] + BLUR


def _end(brightest: np.ndarray, black: int) -> int | None:
    """The line at which a bar ends whose first ``black`` lines are black: the next that is bright nearly all along. None if there is
    none within `REACH`, or the bar has no line."""
    bright = (brightest[black : black + REACH] > DARK + EVEN).mean(1) >= FULL
    return black + int(bright.argmax()) if black and bright.any() else None
