"""Names of images that a program wrote in the code page of its Windows, and not as UTF-8."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from .....pipeline import CaptureError
from .records import ImageRecord

# Chinese, Japanese, Korean, Taiwanese, Western, Russian and Central European Windows
_PAGES = ("cp936", "cp932", "cp949", "cp950", "cp1252", "cp1251", "cp1250")
_SAMPLE = 100  # images whose pictures are looked for


def is_undecoded(name: str) -> bool:
    """Whether ``name`` has bytes that are not UTF-8, which the parsers keep as Python does in names of files."""
    return any("\udc80" <= letter <= "\udcff" for letter in name)


def in_code_page(images: Sequence[ImageRecord], count: Callable[[Sequence[ImageRecord]], int]) -> tuple[list[ImageRecord], str | None]:
    """``images`` with names in the code page by which most of them name pictures, and the page; (the same, None) where all names are UTF-8
    or are those of the pictures byte by byte. count: how many of these images have a picture.

    Raises CaptureError if no code page names pictures of at least half of those images whose names are not UTF-8."""
    odd = [image for image in images if is_undecoded(image.name)]
    some = {image.number for image in odd[:: max(1, len(odd) // _SAMPLE)]}
    if not odd or 2 * count([image for image in odd if image.number in some]) >= len(some):
        return list(images), None
    named: dict[str, dict[int, ImageRecord]] = {}
    for page in _PAGES:
        try:
            named[page] = {image.number: replace(image, name=_raw(image).decode(page)) for image in odd}
        except UnicodeDecodeError:
            continue
    counts = {page: count([found[number] for number in some]) for page, found in named.items()}
    best = max(counts, key=lambda page: counts[page], default=None)  # the first of equal ones
    if best is None or 2 * counts[best] < len(some):
        raise CaptureError(
            f"the names of {len(odd)} of {len(images)} images (first {_raw(odd[0])[:100]!r}) are neither UTF-8 nor, in a code page of "
            "Windows, those of pictures that are there; give the pictures names of plain letters, and make the model again"
        )
    return [named[best].get(image.number, image) for image in images], best


def _raw(image: ImageRecord) -> bytes:
    return image.name.encode("utf-8", "surrogateescape")
