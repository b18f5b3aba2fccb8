"""`focal_length`, `exif_lens`: what the EXIF data of a picture say about its lens."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from .files import BadImageError, open_image

DETAILS, EQUIVALENT = 0x8769, 0xA405  # EXIF tags: the group of details, and in it the focal length on 35 mm film, mm
_REAL, _MODEL = 0x920A, 0x0110  # the focal length, mm; the model of the camera
FILM = 36.0  # mm, width of a picture on 35 mm film


class ExifLens(NamedTuple):
    """focal: mm, on 35 mm film if `equivalent`. model: of the camera, "" if unknown."""

    focal: float
    equivalent: bool
    model: str

    def __str__(self) -> str:
        return f"{self.focal:.3g} mm{' (35 mm equivalent)' if self.equivalent else ''}{f' of {self.model}' if self.model else ''}"


def exif_lens(file: Path) -> ExifLens | None:
    """The lens of a photo, by the EXIF data; None if they do not give a sensible focal length."""
    try:
        with open_image(file) as image:
            exif = image.getexif()
            details, model = exif.get_ifd(DETAILS), exif.get(_MODEL)
    except BadImageError:
        return None
    name = " ".join(model.replace("\0", " ").split())[:80] if isinstance(model, str) else ""
    for tag, equivalent in ((EQUIVALENT, True), (_REAL, False)):
        try:
            focal = float(details.get(tag, "nan"))
        except (TypeError, ValueError, ZeroDivisionError):
            continue
        if 1 <= focal <= 10_000:
            return ExifLens(focal, equivalent, name)
    return None


def film_focal_length(file: Path) -> int | None:
    """The focal length on 35 mm film, mm; None if it is unknown or absurd. EXIF data are often broken, and they are optional."""
    try:
        with open_image(file) as image:
            value = image.getexif().get_ifd(DETAILS).get(EQUIVALENT)
    except BadImageError:
        return None
    return value if isinstance(value, int) and 1 <= value <= 10_000 else None


def focal_length(file: Path) -> float | None:
    """The focal length as a share of the picture's longer side; None if it is unknown."""
    value = film_focal_length(file)
    return None if value is None else value / FILM
