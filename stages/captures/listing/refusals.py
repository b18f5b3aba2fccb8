"""Why a picture or a video cannot be read, and what to do, in words for people: libraries name numbers and objects instead."""

from __future__ import annotations

from pathlib import Path

from .looks_like import looks_like

_PLAIN = "convert the images to RGB or RGBA of 8 or 16 bits"
_AGAIN = "copy it again or remove it from the capture"
_READ = ("a PNG picture", "a JPEG picture", "a TIFF picture", "a WebP picture")
_NUMBERS = {1: "unsigned", 2: "signed", 3: "floating-point"}  # TIFF 6.0, tag 339


def of_picture(file: Path, error: str) -> str:
    """What follows the name of a picture that could not be opened. error: what the library says."""
    if (kind := _tiff_kind(file)) is not None:
        return f"a TIFF picture of {kind}, a kind that is not read; {_PLAIN}"
    likeness = looks_like(file)
    if likeness is None or likeness.words in _READ:
        return f"not a readable image ({error}); {_AGAIN}"
    if likeness.group == "broken":
        return f"{likeness.words}; {_AGAIN}"
    advice = "convert it to JPEG or PNG" if likeness.group == "picture" else "copy or download the picture itself"
    return f"not a readable image: it looks like {likeness.words}; {advice}, or remove the file from the capture"


def of_video(file: Path, error: Exception) -> str:
    """What follows the name of a video that could not be opened. error: of PyAV, or another one."""
    likeness = looks_like(file)
    if likeness is None or likeness.group == "video":
        reason = getattr(error, "strerror", None) or str(error)  # PyAV's own text begins with a number and ends with the path
        return f"not a readable video, perhaps cut short ({reason}); copy it again or convert it to MP4"
    if likeness.group == "broken":
        return f"{likeness.words}; copy it again"
    return f"not a video: it looks like {likeness.words}; copy or download the video itself"


def _tiff_kind(file: Path) -> str | None:
    """The pixels of a TIFF whose numbers are none that pictures have; None for other files and ordinary pixels."""
    from PIL import TiffImagePlugin

    try:
        with file.open("rb") as opened:
            head = opened.read(8)
            if head[:4] not in (b"II*\0", b"MM\0*"):
                return None
            tags = TiffImagePlugin.ImageFileDirectory_v2(head)
            opened.seek(tags.next)
            tags.load(opened)
        bits, numbers = max(tags.get(258, (1,))), max(tags.get(339, (1,)))
        if bits <= 16 and numbers == 1:
            return None
        channels = int(tags.get(277, 1))
    except Exception:  # damaged, which the caller's error says
        return None
    return f"{bits}-bit {_NUMBERS.get(numbers, 'other')} numbers in {channels} channel{'s' if channels != 1 else ''}"
