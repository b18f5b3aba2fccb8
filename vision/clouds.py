"""Scanned point clouds: .pcd, .pts, .xyz and .xyzrgb files, and thinning by voxels.

Open3D reads .pcd files and thins. It is loaded late, since that takes seconds and needs a system library that containers lack. Of text that
is cut short or has words among its numbers, it prints a warning and returns memory that was never written; so numpy, which refuses both,
reads text, or tries it first.
"""

from __future__ import annotations

import itertools
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np

from ..pipeline import StageError

SCANS = (".pcd", ".pts", ".xyz", ".xyzrgb")
ENOUGH = 500_000  # points of a scan that are kept: more than any model begins with
WIDER = 1.3  # factor from voxels that are too many to the next
_COLUMNS = {".pts": (3, 4, 6, 7), ".xyz": (3,), ".xyzrgb": (6,)}  # x y z; .pts: also its intensity, red green blue, or both
_BEGIN = 2**14  # bytes of a file that hold the header of a .pcd file, or the first line of a text
_MOST_BYTES = 2**30
_CUT = "points are promised, but not all are there; perhaps it is cut short; copy it again"


class _Header(NamedTuple):
    """Of a .pcd file. points: their number. columns: numbers of each. whole: bytes of all. way: how they are written. lines: of it."""

    points: int
    columns: int
    whole: int
    way: str
    lines: int


def load_open3d(what: str) -> ModuleType:
    """Open3D. Raises StageError if it cannot be loaded; the message begins with ``what`` needs it, and says what to install."""
    try:
        import open3d
    except ModuleNotFoundError as error:
        raise StageError(f"{what} needs the package open3d; install e4dgs again with its dependencies") from error
    except ImportError as error:
        raise StageError(f"{what}: Open3D cannot be loaded: {error}; on Debian and Ubuntu: apt-get install libusb-1.0-0") from error
    return open3d


def read_scan(path: Path, most: int) -> tuple[np.ndarray, np.ndarray | None]:
    """Points [P, 3] float64 as the file has them, and colours [P, 3] in [0, 1] or None. ``path``: its ending is one of `SCANS`.

    Raises ValueError, which says what is wrong, for files that are malformed, cut short, or have more than ``most`` points; OSError.
    """
    if path.stat().st_size > _MOST_BYTES:
        raise ValueError("larger than a gigabyte; thin the points out")
    kind = path.suffix.lower()
    if kind == ".pcd":
        return _read_pcd(path, most)
    table = _numbers(path, most, counted=kind == ".pts")
    if len(table) and table.shape[1] not in _COLUMNS[kind]:
        raise ValueError(f"rows of {table.shape[1]} numbers; {kind} has {' or '.join(map(str, _COLUMNS[kind]))}")
    colours = table[:, -3:] / (255 if kind == ".pts" else 1) if table.shape[1] >= 6 else None
    return table[:, :3], colours


def thinned(points: np.ndarray, colours: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    """At most `ENOUGH` of ``points`` [P, 3], with ``colours`` [P, 3]: means over voxels, as if the points lay on one square. Few points
    come back as they are. name: of their file, for messages. Raises ValueError if some points are far from all others; StageError."""
    if len(points) <= ENOUGH:
        return points, colours
    open3d = load_open3d(f"{name}: thinning {len(points)} points")
    width = float(np.ptp(np.percentile(points, (2, 98), axis=0), axis=0).max()) / ENOUGH**0.5
    while len(points) > ENOUGH:
        if not np.ptp(points, axis=0).max() < width * 2**30:
            raise ValueError("some points lie much farther away than the others; remove them")
        cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
        cloud.colors = open3d.utility.Vector3dVector(colours)
        cloud = cloud.voxel_down_sample(width)
        points, colours, width = np.array(cloud.points), np.array(cloud.colors), WIDER * width
    return points, colours


def _numbers(path: Path, most: int, counted: bool = False, skip: int = 0) -> np.ndarray:
    """The rows of a text of numbers, after ``skip`` lines. counted: the first line may be their count."""
    with path.open(encoding="ascii") as file:
        first = file.readline(_BEGIN)
        if len(first) == _BEGIN:
            raise ValueError("its first line is too long; write the file again")
        promised = int(first) if counted and first.strip().isdigit() and len(first) < 20 else None
        file.seek(0)
        lines = itertools.islice(file, skip + (promised is not None), most + skip + 2)
        table = np.loadtxt(lines, ndmin=2, comments=("#", "//"))
    if len(table) > most:
        raise ValueError(f"more than {most} points; thin them out")
    if promised is not None and promised != len(table):
        raise ValueError(f"{promised} {_CUT}")
    return table if len(table) else np.zeros((0, 3))


def _read_pcd(path: Path, most: int) -> tuple[np.ndarray, np.ndarray | None]:
    """Points without a measurement, which this format writes as NaN, are left out."""
    with path.open("rb") as file:
        data = file.read(_BEGIN)
    begin = data.find(b"\n", data.find(b"\nDATA ") + 1) + 1
    head, rest = _header(data[:begin]), path.stat().st_size - begin
    if head.points > most:
        raise ValueError(f"{head.points} points are promised, which are too many; thin them out")
    if head.way == "ascii":
        cut = _numbers(path, most, skip=head.lines).shape != (head.points, head.columns)
    elif head.way == "binary_compressed":
        packed, whole = (int.from_bytes(data[begin + k : begin + k + 4], "little") for k in (0, 4))
        cut = packed > rest - 8 or whole != head.whole
    else:
        cut = head.whole > rest
    if cut:
        raise ValueError(f"{head.points} {_CUT}")
    open3d = load_open3d(path.name)
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        cloud = open3d.io.read_point_cloud(str(path), format="pcd")
    points = np.array(cloud.points)
    if len(points) != head.points:
        raise ValueError("Open3D cannot read it; write the file again")
    measured = ~np.isnan(points).any(1)
    return points[measured], np.array(cloud.colors)[measured] if cloud.has_colors() else None


def _header(data: bytes) -> _Header:
    """``data``: all of it; empty if it has no end. See pointclouds.org/documentation/tutorials/pcd_file_format.html."""
    lines = [line.split() for line in data.decode("latin-1").splitlines()]
    head = {line[0]: line[1:] for line in lines if line}
    fields, way = head.get("FIELDS", []), head.get("DATA", [])
    if len(way) != 1 or way[0] not in ("ascii", "binary", "binary_compressed"):
        raise ValueError("not a PCD file, or cut short within its header; copy it again")
    numbers = [head.get(key, default) for key, default in (("SIZE", []), ("COUNT", ["1"] * len(fields)), ("POINTS", []))]
    if not all(n.isdecimal() and 0 < len(n) < 10 for row in numbers for n in row):
        raise ValueError("SIZE, COUNT or POINTS of its header are not numbers; write the file again")
    sizes, counts, points = ([int(n) for n in row] for row in numbers)
    if not {"x", "y", "z"} <= set(fields) or not len(fields) == len(sizes) == len(counts) or len(points) != 1:
        raise ValueError("its header has no x, y, z, or its FIELDS, SIZE, COUNT and POINTS do not agree; write the file again")
    return _Header(points[0], sum(counts), points[0] * sum(size * each for size, each in zip(sizes, counts)), way[0], len(lines))
