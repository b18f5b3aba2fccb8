"""What a file that cannot be read looks like, told by its first bytes: its name says what it should be."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, NamedTuple

from .archive_kind import archive_kind

_HEAD = 1024  # bytes that are looked at
_POINTER = b"version https://git-lfs"
_STILLS = (b"heic", b"heix", b"heim", b"mif1", b"msf1", b"avif", b"avis")


class Likeness(NamedTuple):
    """words: a kind of file with its article, or what is wrong with the file if it is "broken"."""

    words: str
    group: Literal["picture", "video", "broken", "other"]


_BEGINNINGS = {
    b"\x89PNG\r\n": Likeness("a PNG picture", "picture"),
    b"\xff\xd8\xff": Likeness("a JPEG picture", "picture"),
    b"GIF8": Likeness("a GIF animation", "video"),
    b"II*\0": Likeness("a TIFF picture", "picture"),
    b"MM\0*": Likeness("a TIFF picture", "picture"),
    b"8BPS": Likeness("a picture of Photoshop", "picture"),
    b"\x76\x2f\x31\x01": Likeness("an EXR picture", "picture"),
    b"SDPX": Likeness("a DPX picture", "picture"),
    b"XPDS": Likeness("a DPX picture", "picture"),  # little-endian
    b"\x80\x2a\x5f\xd7": Likeness("a Cineon picture", "picture"),
    b"\xd7\x5f\x2a\x80": Likeness("a Cineon picture", "picture"),
    b"#?RADIANCE": Likeness("a Radiance HDR picture", "picture"),
    b"\x01\xda": Likeness("an SGI picture", "picture"),
    b"qoif": Likeness("a QOI picture", "picture"),
    b"II\xbc\x01": Likeness("a JPEG XR picture", "picture"),
    b"YUV4MPEG2 ": Likeness("a Y4M video", "video"),
    b"\0\0\0\x0cJXL ": Likeness("a JPEG XL picture", "picture"),
    b"\0\0\0\x0cjP  ": Likeness("a JPEG 2000 picture", "picture"),
    b"%PDF": Likeness("a PDF document", "other"),
    b"\x1aE\xdf\xa3": Likeness("a Matroska or WebM video", "video"),
}
_RIFF = {
    b"WEBP": Likeness("a WebP picture", "picture"),
    b"AVI ": Likeness("an AVI video", "video"),
    b"WAVE": Likeness("a sound file (WAV)", "other"),
}


def looks_like(file: Path) -> Likeness | None:
    """None if it looks like nothing known or cannot be read."""
    try:
        if not file.is_file():  # reading a pipe would block
            return None
        with file.open("rb") as opened:
            head = opened.read(_HEAD)
    except OSError:
        return None
    if not head:
        return Likeness("the file is empty", "broken")
    if not head.strip(b"\0"):
        return Likeness("the file begins with nothing but zeros, as a copy that failed", "broken")
    if head.startswith(_POINTER):
        return Likeness("this is a pointer of Git LFS in place of the file (git lfs pull fetches it)", "broken")
    if head[4:8] == b"ftyp":
        still = head[8:12] in _STILLS
        return Likeness("a HEIC or AVIF picture", "picture") if still else Likeness("an MP4 or MOV video", "video")
    if head[:4] == b"RIFF" and head[8:12] in _RIFF:
        return _RIFF[head[8:12]]
    if (archive := archive_kind(file)) is not None:
        return Likeness(f"an archive ({archive})", "other")
    known = next((kind for start, kind in _BEGINNINGS.items() if head.startswith(start)), None)
    return known or _text(head)


def _text(head: bytes) -> Likeness | None:
    start = head.removeprefix(b"\xef\xbb\xbf").lstrip()[:200].lower()
    if start.startswith((b"<!doctype html", b"<html", b"<head", b"<body")):
        return Likeness("a web page (HTML)", "other")
    try:
        text = head.decode()
    except UnicodeDecodeError as error:
        if error.start < len(head) - 3:  # a character may be cut at the end
            return None
        text = head[: error.start].decode()
    return Likeness("a text file", "other") if all(c.isprintable() or c in "\t\r\n\f" for c in text) else None
