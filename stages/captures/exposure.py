"""`exposure`: what the EXIF data of a photo say about when it was taken, and how much light it got."""

from __future__ import annotations

import math
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

from ...vision.images.files import BadImageError, open_image

DETAILS = 0x8769  # the group of these tags:
TAKEN, FRACTION = 0x9003, 0x9291  # local time as text, and the digits of its second after the point
SHUTTER, STOP, SPEED, BIAS = 0x829A, 0x829D, 0x8827, 0x9204  # s, f-number, ISO, and stops that were asked for
KINDS = ("JPEG", "MPO", "TIFF")  # of files that cameras write


class Exposure(NamedTuple):
    """second: of local time, from some day on; whole where the camera does not say more. stops: log2 of the light, from any zero."""

    second: float
    stops: float


def exposure(file: Path) -> Exposure | None:
    """None if a photo does not say when it was taken, or for how long it was exposed. EXIF data are often broken, and they are optional."""
    found = _details(file)
    shutter, second = _positive(found.get(SHUTTER)), _second(found)
    speed, stop = _positive(found.get(SPEED)) or 100.0, _positive(found.get(STOP)) or 1.0
    return None if shutter is None or second is None else Exposure(second, math.log2(shutter * speed / stop**2))


def second_of(file: Path) -> float | None:
    """When a photo was taken, as in `Exposure`; None if it does not say."""
    return _second(_details(file))


def _details(file: Path) -> dict[int, Any]:
    try:
        with open_image(file) as image:
            return dict(image.getexif().get_ifd(DETAILS)) if image.format in KINDS else {}
    except BadImageError:  # its reader says why
        return {}


def _second(found: dict[int, Any]) -> float | None:
    try:
        second = datetime.strptime(str(found.get(TAKEN)).strip("\0 "), "%Y:%m:%d %H:%M:%S").timestamp()
    except (ValueError, OverflowError, OSError):
        return None
    digits = str(found.get(FRACTION, "")).strip("\0 ")
    return second + (float(f"0.{digits}") if digits.isascii() and digits.isdecimal() and len(digits) < 10 else 0.0)


def _positive(value: Any) -> float | None:
    """A number, or the first of several; None if it is none, or absurd."""
    try:
        number = float(value[0] if isinstance(value, tuple) else value)
    except (TypeError, ValueError, IndexError, ZeroDivisionError, OverflowError):
        return None
    return number if 1e-9 < number < 1e9 else None
