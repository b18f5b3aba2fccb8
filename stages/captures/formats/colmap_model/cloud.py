"""The points of a COLMAP model: in its own files, and in the PLY that programs for Gaussian splatting put beside them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from .....pipeline import CaptureError
from ...arrays import MOST_POINTS
from ...ply_points import count_of, read_points
from . import binary, text
from .places import Place, about
from .records import too_many_points

_PLY = ("points3D.ply", "points3d.ply")


class Cloud(NamedTuple):
    """points [P,3] float64 in the model's world, colors [P,3] uint8; P may be 0. files: those on which this depends. notes: for people."""

    points: np.ndarray
    colors: np.ndarray
    files: tuple[str, ...]
    notes: tuple[str, ...]


def read_cloud(place: Place) -> Cloud:
    """The points of the model at ``place``: of points3D with its own suffix or the other one, or of points3D.ply, if that is alone or has
    another number of points, as a denser cloud has. Errors are CaptureErrors that name the file."""
    own = next((file for file in _files(place) if (place.root / file).is_file()), None)
    ply = next((name for name in (place.named(name) for name in _PLY) if (place.root / name).is_file()), None)
    table = np.zeros((0, 6)) if own is None else _table(place, own)
    points, colors = table[:, :3].copy(), np.clip(table[:, 3:], 0, 255).astype(np.uint8)
    files, notes = tuple(file for file in (own, ply) if file is not None), tuple[str, ...]()
    if ply is None:
        return Cloud(points, colors, files, notes)
    try:
        if own is None or count_of(place.root, ply) != len(points):
            found = read_points(place.root, ply)
            notes = () if own is None else (_told(ply, len(found[0]), own, len(points)),)
            points, colors = found
    except CaptureError as error:
        if own is None:
            raise
        notes = (f"the points of {own} are read, and not those of {ply}: {error}",)
    return Cloud(points, colors, files, notes)


def _told(ply: str, count: int, own: str, other: int) -> str:
    return (
        f"the {count} points of {ply} are read, as other programs for Gaussian splatting do, and not the {other} of {own}; to begin at "
        "those, take the PLY file out of the folder"
    )


def _files(place: Place) -> Iterator[str]:
    for suffix in (place.suffix, *(other for other in (".bin", ".txt") if other != place.suffix)):
        yield place.named(f"points3D{suffix}")


def _table(place: Place, file: str) -> np.ndarray:
    """[P, 6] float64: x y z r g b."""
    parser = binary if file.endswith(".bin") else text
    with about(file):
        rows = itertools.islice(parser.points(place.path(file)), MOST_POINTS + 1)
        table = np.fromiter(rows, dtype=np.dtype((np.float64, 6)))
        if len(table) > MOST_POINTS:
            raise CaptureError(too_many_points(f"more than {MOST_POINTS}", MOST_POINTS))
    good = (np.abs(table) < 1e12).all(1)
    if not good.all():
        row = int(good.argmin())
        raise CaptureError(f"{file}: point {row}: {table[row, :3].tolist()} is not a valid position; remove it")
    return table
