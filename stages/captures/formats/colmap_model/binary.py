"""COLMAP's binary files."""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from .....pipeline import CaptureError
from ...arrays import MOST_POINTS
from .records import LAYOUT, MODELS, MOST_IMAGES, CameraRecord, FrameRecord, ImageRecord, refusal, too_many_points

_LONGEST_NAME = 4096
_MOST_SENSORS = 100_000  # of a rig
_CAMERA = 0  # among kinds of sensors


class _Bytes:
    """Reads little-endian records. Running past the end raises `struct.error`. The file is memory-mapped, since the images file also
    contains every feature and may be larger than the memory."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            self.data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)  # ValueError for an empty file
        self.at = 0

    def count(self, what: str, most: int, least: int) -> int:
        """Reads the number of records that follow, each of at least ``least`` bytes."""
        count = int(self.take("Q")[0])
        if count * least > len(self.data) - self.at:
            raise ValueError(f"{count} {what} in {len(self.data)} bytes")
        if count > most:  # and they are there, so nothing is cut short
            told = (
                too_many_points(str(count), most) if what == "points" else f"it has {count} {what}, and at most {most} are read; split it"
            )
            raise CaptureError(told)
        return count

    def take(self, layout: str) -> tuple:
        values = struct.unpack_from("<" + layout, self.data, self.at)
        self.at += struct.calcsize("<" + layout)
        return values

    def skip(self, count: int) -> None:
        self.at += count
        if self.at > len(self.data):
            raise struct.error(f"ends after {len(self.data)} bytes")

    def name(self) -> str:
        end = self.data.find(b"\0", self.at, self.at + _LONGEST_NAME)
        if end < 0:
            raise ValueError(f"a name without an end at byte {self.at}")
        text = self.data[self.at : end].decode("utf-8", "surrogateescape")  # see `code_pages.py`
        self.at = end + 1
        return text


def cameras(path: Path) -> Iterator[tuple[int, CameraRecord]]:
    source = _Bytes(path)
    for _ in range(source.count("cameras", MOST_IMAGES, 48)):
        number, kind, width, height = source.take("iiQQ")
        model = MODELS[kind] if 0 <= kind < len(MODELS) else f"number {kind}"
        if model not in LAYOUT:  # the length of its record is unknown, so it cannot be skipped
            raise CaptureError(f"camera {number}: {refusal(model)}")
        one_focal, count = LAYOUT[model]
        yield number, (model, float(width), float(height), list(source.take(f"{4 - one_focal + count}d")))


def images(path: Path) -> Iterator[ImageRecord]:
    source = _Bytes(path)
    for _ in range(source.count("images", MOST_IMAGES, 73)):
        number, *pose, camera = source.take("i7di")
        name = source.name()
        source.skip(24 * source.take("Q")[0])
        yield ImageRecord(name, camera, np.array(pose), number)


def frames(path: Path) -> Iterator[FrameRecord]:
    source = _Bytes(path)
    for _ in range(source.count("frames", MOST_IMAGES, 68)):
        number, rig, *_, count = source.take("II7dI")
        if count > _MOST_SENSORS:
            raise ValueError(f"frame {number} has {count} pictures")
        data = [source.take("iIQ") for _ in range(count)]
        yield FrameRecord(number, rig, {sensor: image for kind, sensor, image in data if kind == _CAMERA})


def points(path: Path) -> Iterator[list[float]]:
    source = _Bytes(path)
    for _ in range(source.count("points", MOST_POINTS, 51)):
        _, *values = source.take("Q3d3Bd")
        source.skip(8 * source.take("Q")[0])
        yield [float(v) for v in values[:6]]
