"""The shape in which a video's pictures are shown: square pixels, turned and mirrored as the file's display matrix says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from ....pipeline import CaptureError

MOST_STRETCHED = 4  # times as wide as high, or as high as wide; DV, HDV and anamorphic lenses stay below 2
_ALIKE = 0.02  # relative difference of aspect ratios below which sizes are scalings of one another
_OFF_AXIS = 0.02  # of a matrix's numbers, about one degree: writers round them
STRAIGHT = (1, 0, 0, 1)
_TURNS = {  # how a picture with this turn is shown
    STRAIGHT: "",
    (0, 1, -1, 0): "turned by 90 degrees clockwise",
    (-1, 0, 0, -1): "turned by 180 degrees",
    (0, -1, 1, 0): "turned by 90 degrees counterclockwise",
    (-1, 0, 0, 1): "mirrored",
    (1, 0, 0, -1): "mirrored top to bottom",
    (0, 1, 1, 0): "mirrored and turned",
    (0, -1, -1, 0): "mirrored and turned",
}


_EYES = {1: "crop=iw/2:ih:0:0", 2: "crop=iw:ih/2:0:0"}  # FFmpeg's numbers: side by side, one above the other
_BESIDE = (3, 8)  # MV-HEVC of phones, and MVC in Matroska


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


def turn_told(frame: Any) -> str | None:
    """A line about how the picture is turned and mirrored, or what of the display matrix is not followed; None if it is shown as stored."""
    matrix = _matrix(frame)
    if matrix is None or not any(matrix):
        return None
    shown = _TURNS[axis_turn(matrix)]
    a, b, c, d = matrix
    size = max(map(abs, matrix))
    if min(max(abs(a), abs(d)), max(abs(b), abs(c))) < _OFF_AXIS * size:  # FFmpeg makes shapes of pixels of what it stretches
        return f"it is shown {shown}, as the file asks" if shown else None
    angle = np.degrees(np.arctan2(b, a))
    is_turn = max(abs(a - d), abs(b + c)) < _OFF_AXIS * size
    asked = f"turn it by {abs(angle):.3g} degrees {'counter' if angle < 0 else ''}clockwise" if is_turn else "skew it"
    return (
        f"its display matrix would {asked}; only quarter turns and mirroring are followed, so it is shown {shown or 'as stored'}; if "
        "that is wrong, change its pixels"
    )


def eyes_told(frame: Any, name: str) -> str | None:
    """A line if the pictures of another eye are not decoded. Raises CaptureError if each picture holds those of both."""
    from av.sidedata.sidedata import Type

    data = frame.side_data.get(Type.STEREO3D)
    kind, view = (0, 0) if data is None else np.frombuffer(bytes(data), np.int32)[[0, 2]].tolist()
    if kind in _EYES:
        raise CaptureError(
            f"{name}: 3D video, two pictures in one; keep one: ffmpeg -i FILE -vf {_EYES[kind]},sidedata=delete left.mp4 (behind delete "
            f",setsar={'2' if kind == 1 else '1/2'} if it looks squeezed)"
        )
    return "3D video: one eye is read" if kind in _BESIDE and not view else None


def is_plausible(pixel: Fraction) -> bool:
    return 1 / MOST_STRETCHED <= pixel <= MOST_STRETCHED


def _turn(frame: Any) -> tuple[int, int, int, int]:
    matrix = _matrix(frame)
    return STRAIGHT if matrix is None else axis_turn(matrix)


def _matrix(frame: Any) -> list[int] | None:
    """a, b, c, d of the display matrix of a frame, in units of 1/65536; None if it has none."""
    from av.sidedata.sidedata import Type

    data = frame.side_data.get(Type.DISPLAYMATRIX)
    matrix = None if data is None else np.frombuffer(bytes(data), np.int32)
    return matrix[[0, 1, 3, 4]].tolist() if matrix is not None and len(matrix) == 9 else None


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
