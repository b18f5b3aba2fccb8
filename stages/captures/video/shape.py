"""The shape in which a video's pictures are shown: square pixels, turned and mirrored as the file's display matrix says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

MOST_STRETCHED = 4  # times as wide as high, or as high as wide; DV, HDV and anamorphic lenses stay below 2
_ALIKE = 0.02  # relative difference of aspect ratios below which sizes are scalings of one another
STRAIGHT = (1, 0, 0, 1)


@dataclass(frozen=True)
class Shape:
    """stored: width and height of the pictures in the file, px. pixel: width of a pixel over its height. turn: a, b, c, d of the display
    matrix, each -1, 0 or 1: the point (x, y) is shown at (a x + c y, b x + d y)."""

    stored: tuple[int, int]
    pixel: Fraction = Fraction(1)
    turn: tuple[int, int, int, int] = STRAIGHT

    @cached_property
    def square(self) -> tuple[int, int]:
        """Width and height, px, with square pixels, before turning. The longer side is kept."""
        width, height = self.stored
        longer, aspect = max(self.stored), width * self.pixel / height
        return (longer, max(1, round(longer / aspect))) if aspect >= 1 else (max(1, round(longer * aspect)), longer)

    @cached_property
    def shown(self) -> tuple[int, int]:
        """Width and height, px, with square pixels, as shown."""
        width, height = self.square
        return (width, height) if self.turn[0] else (height, width)

    @property
    def is_mirrored(self) -> bool:
        a, b, c, d = self.turn
        return a * d - b * c < 0

    def turned(self, picture: np.ndarray) -> np.ndarray:
        """The stored picture [H,W,3] turned and mirrored as it is shown; its pixels are still not square."""
        a, b, c, d = self.turn
        if not a:
            picture, (a, d) = picture.transpose(1, 0, 2), (c, b)
        if a < 0:
            picture = picture[:, ::-1]
        return picture[::-1] if d < 0 else picture


def alike(first: tuple[int, int], second: tuple[int, int]) -> bool:
    """Whether two sizes have one aspect ratio, up to rounding."""
    return abs(first[0] * second[1] / (first[1] * second[0]) - 1) < _ALIKE


def shape_of(frame: Any, pixel: Fraction | None) -> Shape:
    """pixel: the aspect ratio of a pixel that the stream gives; None, 0 and impossible ones count as 1."""
    return _shape(frame.width, frame.height, pixel, _turn(frame))


@lru_cache(64)  # every frame asks
def _shape(width: int, height: int, pixel: Fraction | None, turn: tuple[int, int, int, int]) -> Shape:
    return Shape((width, height), pixel if pixel is not None and is_plausible(pixel) else Fraction(1), turn)


def is_plausible(pixel: Fraction) -> bool:
    return 1 / MOST_STRETCHED <= pixel <= MOST_STRETCHED


def _turn(frame: Any) -> tuple[int, int, int, int]:
    from av.sidedata.sidedata import Type

    data = frame.side_data.get(Type.DISPLAYMATRIX)
    if data is None:
        return STRAIGHT
    matrix = np.frombuffer(bytes(data), np.int32)
    return axis_turn(matrix[[0, 1, 3, 4]].tolist()) if len(matrix) == 9 else STRAIGHT


def axis_turn(matrix: Sequence[int]) -> tuple[int, int, int, int]:
    """The nearest of the eight turns that map axes to axes; no turn for a matrix that maps the plane to a line."""
    a, b, c, d = (int(v) for v in matrix)
    if a * d == b * c:
        return STRAIGHT
    straight, crossed = abs(a) + abs(d), abs(b) + abs(c)
    if straight >= crossed:
        # the determinant says whether the picture is mirrored, the larger number which axis
        if a * d - b * c > 0:
            return (1, 0, 0, 1) if a + d > 0 else (-1, 0, 0, -1)
        return (1, 0, 0, -1) if a - d > 0 else (-1, 0, 0, 1)
    if a * d - b * c > 0:
        return (0, 1, -1, 0) if b - c > 0 else (0, -1, 1, 0)
    return (0, 1, 1, 0) if b + c > 0 else (0, -1, -1, 0)
