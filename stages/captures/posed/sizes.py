"""`scale_of`: from the size of picture that a calibration was made for to the picture itself."""

from __future__ import annotations

from pathlib import Path

from ....pipeline import CaptureError
from .. import checks

_SAME = 0.02  # largest relative difference of two aspect ratios: sizes are rounded to pixels


def scale_of(root: Path, picture: str, size: tuple[int, int], made_for: tuple[float, float], where: str) -> tuple[float, float]:
    """Factors in x and y by which intrinsics made for pictures of ``made_for`` px are scaled to ``picture`` of ``size`` px, as stored.

    Raises CaptureError if the aspect ratios differ. If they would fit once the picture is turned as its EXIF data ask, it says so: viewers
    and other programs then show the picture in the size that the file gives."""
    (width, height), (w, h) = size, made_for
    sx, sy = width / w, height / h
    if abs(sx / sy - 1) <= _SAME:
        return sx, sy
    advice = "which has another aspect ratio; correct the size or resize the pictures"
    turn = checks.orientation(root, picture)
    if turn in checks.LYING and abs((height / w) / (width / h) - 1) <= _SAME:
        advice = (
            f"because its EXIF orientation ({turn}) asks for a quarter turn, after which it is {height}x{width}. Poses apply to the pixels "
            "as stored: rotate the pixels themselves and remove the EXIF orientation, then the sizes agree"
        )
    raise CaptureError(f"{where} {w:g}x{h:g}, but {picture} is {width}x{height}, {advice}")
