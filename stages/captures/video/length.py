"""Whether a file is as long as its container says. What was cut off the end of a file shows in no other way: the rest plays."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

_MOST_BOXES = 100_000
_SLACK = 16  # bytes; some programs count the header of an AVI, or a padding byte, too
_HOLD_MEDIA = (b"mdat", b"moov", b"moof")


def is_cut_short(path: Path) -> bool:
    """Whether an MP4, AVI, Matroska or GIF file ends before the end of its media. Other containers do not tell."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(12)
        if head[4:8] in (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip"):
            return _boxes_end(file, size)
        if head[:4] == b"RIFF" and head[8:12] in (b"AVI ", b"AVIX"):
            return _riff_ends(file, size)
        if head[:4] == b"\x1aE\xdf\xa3":
            return _segment_ends(file, size)
        if head[:6] in (b"GIF87a", b"GIF89a") and len(head) > 10:
            return _blocks_end(file, head)
    return False


def _boxes_end(file: BinaryIO, size: int) -> bool:
    at = 0
    for _ in range(_MOST_BOXES):
        file.seek(at)
        head = file.read(16)
        if len(head) < 8:
            return False
        length, kind = struct.unpack(">I4s", head[:8])
        if length == 1 and len(head) == 16:
            (length,) = struct.unpack(">Q", head[8:])
        if length < 8:  # 0: up to the end of the file
            return False
        if at + length > size:
            return kind in _HOLD_MEDIA
        at += length
    return False


def _riff_ends(file: BinaryIO, size: int) -> bool:
    at = 0
    for _ in range(_MOST_BOXES):
        file.seek(at)
        head = file.read(12)
        if len(head) < 12 or head[:4] != b"RIFF":
            return False
        (length,) = struct.unpack("<I", head[4:8])
        if length in (0, 2**32 - 1):  # a recorder that was stopped hard never wrote it
            return False
        if at + 8 + length > size + _SLACK:
            return True
        at += 8 + length + length % 2
    return False


def _segment_ends(file: BinaryIO, size: int) -> bool:
    at = 0
    for _ in range(2):
        file.seek(at)
        head = file.read(12)
        if len(head) < 12:
            return False
        kind = head[:4]
        digits = 9 - head[4].bit_length()  # EBML: the leading zeros give the number of bytes
        if digits > 8:
            return False
        length = int.from_bytes(head[4 : 4 + digits], "big") & ((1 << 7 * digits) - 1)
        if length == (1 << 7 * digits) - 1:  # unknown, as in streams
            return False
        at += 4 + digits + length
        if kind == b"\x18\x53\x80\x67":
            return at > size
    return False


def _blocks_end(file: BinaryIO, head: bytes) -> bool:
    """Whether the blocks of a GIF end without its trailer (GIF89a, section 27). What programs append behind the trailer does not matter."""

    def colours(flags: int) -> int:
        """Bytes of the table of colours that may follow."""
        return 3 << (flags & 7) + 1 if flags & 0x80 else 0

    file.seek(13 + colours(head[10]))
    while kind := file.read(1):
        if kind == b"\x3b":
            return False
        if kind == b"\x2c":  # a picture: its place, its colours, and the size of its codes
            place = file.read(9)
            file.seek(1 + colours(place[-1] if place else 0), 1)
        elif kind == b"\x21":  # an extension
            file.seek(1, 1)
        else:  # damaged, which decoding tells
            return False
        length = file.read(1)
        while length and length != b"\0":
            length = file.read(length[0] + 1)[length[0] :]  # a piece of the data, and the length of the next one
    return True
