"""`focal_length`: what the EXIF data of a picture say about its lens."""

from __future__ import annotations

from pathlib import Path

from .files import BadImageError, open_image

DETAILS, EQUIVALENT = 0x8769, 0xA405  # EXIF tags: the group of details, and in it the focal length on 35 mm film, mm
FILM = 36.0  # mm, width of a picture on 35 mm film


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
