"""Reads points and colours from a PLY file, ASCII or binary, as written by COLMAP, nerfstudio and scanners (faces and other elements are
ignored), or from a scan in another format.

PLY files are read here, not by Open3D, whose import takes seconds at every plan and fails where the system lacks libusb, and which returns
memory that was never written for a file that is cut short. For whole files both read the same (a test compares them).
"""

from __future__ import annotations

from pathlib import Path
from typing import IO

import numpy as np

from ...pipeline import CaptureError
from ...vision.clouds import SCANS, read_scan, thinned
from . import checks
from .arrays import MOST_POINTS
from .reading import Reading

_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}
_ORDER = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_HEADER_LIMIT = 64 * 2**10
_BLOCK = 2**24  # bytes of an ASCII file that are split into words at a time
_GREY = 128  # colour of points without one
_COLOURS = (  # names of a vertex's colours, in small letters: usual ones, MeshLab's and older scanners'
    ("red", "green", "blue"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
    ("r", "g", "b"),
    ("ambient_red", "ambient_green", "ambient_blue"),
    ("scalar_red", "scalar_green", "scalar_blue"),
)
_HARMONIC = ("f_dc_0", "f_dc_1", "f_dc_2")  # of splats: colours as the first spherical harmonic
_Y0 = 0.28209479177387814  # its value
_FRACTION = 16.0  # float colours above it count to 255, not to 1


def read_points(root: Path, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Points [P,3] float64 in the file's own world, and colours [P,3] uint8, grey without any, of `root/name`; P may be 0. Colours of a PLY
    file count to 255; floats to 1 unless some are far above, 16-bit ones to 65535 if some exceed 255. Scans (`SCANS`) are thinned.

    Raises CaptureError for broken or truncated files, for vertices without x, y, z, and for values that are not finite.
    """
    path = checks.resolve_inside(root, name, name)
    try:
        if path.suffix.lower() not in SCANS:
            points, colours = _read_ply(path, name)
            _check_finite(points, name)
            return points, colours
        points, fractions = read_scan(path, MOST_POINTS)
        _check_finite(points, name)
        fractions = np.full(points.shape, _GREY / 255) if fractions is None else fractions
        points, fractions = thinned(points, np.nan_to_num(fractions).clip(0, 1), name)
        return points, np.rint(255 * fractions).astype(np.uint8)
    except OSError as error:
        raise CaptureError(f"{name}: cannot be read ({error.strerror}); check the file and its permissions") from error
    except ValueError as error:
        raise CaptureError(f"{name}: {error}") from error


def count_of(root: Path, name: str) -> int:
    """Number of points that the header of the PLY file `root/name` promises. Raises CaptureError."""
    try:
        with checks.resolve_inside(root, name, name).open("rb") as file:
            return _header(file.read(_HEADER_LIMIT), name)[1]
    except OSError as error:
        raise CaptureError(f"{name}: cannot be read ({error.strerror}); check the file and its permissions") from error


def _check_finite(points: np.ndarray, name: str) -> None:
    bad = np.flatnonzero(~(np.abs(points) < 1e12).all(1))
    if len(bad):
        raise CaptureError(f"{name}: vertex {bad[0]}: x, y, z = {points[bad[0]].tolist()} is not a valid position; remove the vertex")


def _read_ply(path: Path, name: str) -> tuple[np.ndarray, np.ndarray]:
    with path.open("rb") as file:
        order, count, fields, begin = _header(file.read(_HEADER_LIMIT), name)
        if count > MOST_POINTS:
            raise CaptureError(f"{name}: {count} vertices are promised, which are too many points; thin them out")
        file.seek(begin)
        rest = path.stat().st_size - begin
        try:
            table = _ascii(file, rest, count, fields) if order == "ascii" else _binary(file, rest, count, fields, _ORDER[order])
        except (ValueError, TypeError) as error:
            raise ValueError(
                f"{count} vertices are promised, but not all are there; perhaps it is cut short ({error}); copy it again"
            ) from error
    return np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=1), _colours(table, dict(fields), count, name)


def add_points(reading: Reading, root: Path, name: str) -> None:
    """Gives ``reading`` the points of `root/name`, if there are any, and a line if those of a PLY file came without colours."""
    points, colours = read_points(root, name)
    reading.sources += (name,)
    if len(points):
        reading.points, reading.point_colors = points, colours
        if not name.lower().endswith(tuple(SCANS)) and (colours == _GREY).all():
            reading.notes += (f"{name} has no colours under names that are known (red, green, blue): its points are grey",)


def _colours(table: dict[str, np.ndarray], types: dict[str, str], count: int, name: str) -> np.ndarray:
    by_name = {field.lower(): field for field in table}
    channels = next((c for c in (*_COLOURS, _HARMONIC) if all(channel in by_name for channel in c)), None)
    if channels is None:
        return np.full((count, 3), _GREY, np.uint8)
    fields = [by_name[channel] for channel in channels]
    values = np.stack([table[field].astype(np.float64) for field in fields], axis=1)
    bad = np.flatnonzero(~np.isfinite(values).all(1))
    if len(bad):
        raise CaptureError(f"{name}: vertex {bad[0]}: its colour is not a number; correct or remove the vertex")
    kinds, most = {types[field] for field in fields}, values.max(initial=0.0)
    if channels == _HARMONIC:
        values = 255 * (0.5 + _Y0 * values)
    elif all(kind[0] == "f" for kind in kinds):
        values *= 255 if most <= _FRACTION else 1
    elif kinds == {"u2"} and most > 255:
        values /= 257  # 65535 is white
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _header(data: bytes, name: str) -> tuple[str, int, list[tuple[str, str]], int]:
    """(format, number of vertices, [(field, type)], offset of the body)."""
    end = data.find(b"end_header", 0, _HEADER_LIMIT)
    newline = data.find(b"\n", end)
    if not data.startswith(b"ply") or end < 0 or newline < 0:
        raise CaptureError(f"{name}: not a PLY file, or cut short within its header; copy it again")
    words = [line.split() for line in data[:end].decode("latin-1").splitlines()]
    order = next((line[1] for line in words if line[:1] == ["format"] and len(line) > 1), "")
    if order not in _ORDER:
        raise CaptureError(f"{name}: format {order[:40]!r}; expected {', '.join(_ORDER)}, write the file again")
    elements = [i for i, line in enumerate(words) if line[:1] == ["element"]]
    if not elements or words[elements[0]][1:2] != ["vertex"]:
        raise CaptureError(f"{name}: the first element is not vertex; write the file again, points first")
    if len(words[elements[0]]) != 3 or not words[elements[0]][2].isdecimal() or len(words[elements[0]][2]) > 12:
        raise CaptureError(f"{name}: element vertex has no count; write the file again")
    fields: list[tuple[str, str]] = []
    for line in words[elements[0] + 1 : elements[1] if len(elements) > 1 else None]:
        if line[:1] == ["property"]:
            if len(line) != 3 or line[1] not in _TYPES or line[2] in dict(fields):
                raise CaptureError(f"{name}: vertex property {' '.join(line[1:])[:80]!r} is not supported; write x, y, z and colours alone")
            fields.append((line[2], _TYPES[line[1]]))
    missing = [axis for axis in "xyz" if axis not in dict(fields)]
    if missing:
        raise CaptureError(f"{name}: vertices have no {', '.join(missing)}; write the file again")
    return order, int(words[elements[0]][2]), fields, newline + 1


def _binary(file: IO[bytes], rest: int, count: int, fields: list[tuple[str, str]], order: str) -> dict[str, np.ndarray]:
    """Reads `count` vertices from `file`, which has `rest` bytes left."""
    kind = np.dtype([(field, order + code) for field, code in fields])
    if count * kind.itemsize > rest:
        raise ValueError(f"{rest} bytes")
    table = np.frombuffer(file.read(count * kind.itemsize), kind, count)
    return {field: table[field] for field, _ in fields}


def _ascii(file: IO[bytes], rest: int, count: int, fields: list[tuple[str, str]]) -> dict[str, np.ndarray]:
    wanted = count * len(fields)
    if 2 * wanted - 1 > rest:  # each number takes at least a digit and a space
        raise ValueError(f"{rest} bytes")
    parts, got, tail = [np.zeros(0)], 0, b""
    while got < wanted:
        block = file.read(_BLOCK)
        words = (tail + block).split()
        tail = words.pop() if block and words and not block[-1:].isspace() else b""
        if (not block and not words) or len(tail) > _HEADER_LIMIT:
            raise ValueError(f"{got} numbers")
        parts.append(np.array(words[: wanted - got], dtype=np.float64))
        got += len(parts[-1])
    table = np.concatenate(parts).reshape(count, len(fields))
    return {field: table[:, i] for i, (field, _) in enumerate(fields)}
