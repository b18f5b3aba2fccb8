"""COLMAP's text files, read as COLMAP reads them (`ReadImagesText` and its kin in src/colmap/scene/reconstruction_io_text.cc)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from .records import CameraRecord, FrameRecord, ImageRecord

_LONGEST_LINE = 2**26  # characters; the line of an image's features lists about ten thousand of them
_WHOLE = 2**16  # characters; of longer lines of features only both ends are checked
_UTF_16 = ("\udcff\udcfe", "\udcfe\udcff")  # its byte order marks


class NotKeypoints(ValueError):
    """A line that should list an image's keypoints does not."""


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """(number, text) of the lines that are no comments, without the blanks around them. A byte order mark is skipped; bytes that are not
    UTF-8 are kept, see `code_pages.py`."""
    with path.open(encoding="utf-8-sig", errors="surrogateescape") as file:
        number = 0
        while line := file.readline(_LONGEST_LINE):
            number += 1
            if len(line) == _LONGEST_LINE:
                raise ValueError(f"line {number} has more than {_LONGEST_LINE} characters")
            if number == 1 and line.startswith(_UTF_16):
                raise ValueError("it is UTF-16; save it as UTF-8")
            line = line.strip()
            if not line.startswith("#"):
                yield number, line


def cameras(path: Path) -> Iterator[tuple[int, CameraRecord]]:
    for number, line in _lines(path):
        if line:
            words = line.split()
            if len(words) < 4:
                raise ValueError(f"line {number} has {len(words)} words and no camera")
            yield _int(words[0], number), (words[1], *(_float(w, number) for w in words[2:4]), [_float(w, number) for w in words[4:]])  # type: ignore[misc]


def images(path: Path) -> Iterator[ImageRecord]:
    """Empty lines and comments are skipped where an image is expected. The line after an image lists its keypoints and may be empty or,
    at the end, missing. Raises NotKeypoints if it is something else, such as another image."""
    lines = _lines(path)
    for number, line in lines:
        if not line:
            continue
        yield _image(line, number)
        below = next(lines, None)
        if below is not None and not _lists_keypoints(below[1]):
            found = "another image" if _looks_like_image(below[1]) else f"{below[1][:40]!r}"
            raise NotKeypoints(f"line {below[0]} should list keypoints or be empty; found {found}")


def bare_images(path: Path) -> list[ImageRecord] | None:
    """The images of a file without lines of keypoints: every line that is neither empty nor a comment is one. None if it is no such file,
    or if it names an image twice."""
    found = []
    for number, line in _lines(path):
        if line and not _looks_like_image(line):
            return None
        if line:
            found.append(_image(line, number))
    return found if len({image.name for image in found}) == len(found) else None


def points(path: Path) -> Iterator[list[float]]:
    for number, line in _lines(path):
        if line:
            words = line.split(maxsplit=7)
            if len(words) < 7:
                raise ValueError(f"line {number} has {len(words)} words and no point")
            yield [_float(word, number) for word in words[1:7]]


def frames(path: Path) -> Iterator[FrameRecord]:
    for number, line in _lines(path):
        if line:
            words = line.split()
            if len(words) < 10 or len(words) != 10 + 3 * _int(words[9], number):
                raise ValueError(f"line {number} is no frame of a rig")
            data = zip(words[10::3], words[11::3], words[12::3], strict=True)
            images = {_int(sensor, number): _int(image, number) for kind, sensor, image in data if kind == "CAMERA"}
            yield FrameRecord(_int(words[0], number), _int(words[1], number), images)


def _image(line: str, number: int) -> ImageRecord:
    parts = line.split(maxsplit=9)
    if len(parts) < 10:
        raise ValueError(f"line {number} has {len(parts)} words, an image has ten")
    pose = np.array([_float(v, number) for v in parts[1:8]], dtype=np.float64)
    return ImageRecord(parts[9], _int(parts[8], number), pose, _int(parts[0], number))


def _looks_like_image(line: str) -> bool:
    parts = line.split(maxsplit=9)
    return len(parts) == 10 and parts[0].isdecimal() and parts[8].isdecimal() and all(map(_is_number, parts[1:8]))


def _lists_keypoints(line: str) -> bool:
    """x, y and the id of a point for each."""
    if not line:
        return True
    if len(line) > _WHOLE:
        first, last = line[:_WHOLE].split()[:9], line[-200:].split()[1:]
        return all(map(_is_number, first)) and all(map(_is_number, last))
    words = line.split()
    return len(words) % 3 == 0 and all(map(_is_number, words))


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _float(word: str, number: int) -> float:
    try:
        return float(word)
    except ValueError:
        raise ValueError(f"line {number}: {word[:40]!r} is not a number") from None


def _int(word: str, number: int) -> int:
    try:
        return int(word)
    except ValueError:
        raise ValueError(f"line {number}: {word[:40]!r} is not a whole number") from None
