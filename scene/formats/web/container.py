"""The file that holds a scene's arrays: a header in JSON, and one zlib stream."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from .arrays import Coded, bytes_of, description_of

MAGIC, VERSION = b"E4DW", 1
MOST_HEADER = 1 << 24  # bytes
MOST_DATA = 1 << 30  # bytes before compression


def pack(header: dict[str, Any], arrays: Sequence[Coded]) -> bytes:
    """The file: magic, version and length of the header (uint32 each, little-endian), the header, the compressed bytes of all arrays in its
    order. ``header`` is JSON; "arrays" is added to it."""
    said = json.dumps(header | {"arrays": [one.header for one in arrays]}, separators=(",", ":"), allow_nan=False).encode()
    squeeze = zlib.compressobj(9, zlib.DEFLATED, 15, 9)
    data = b"".join([*(squeeze.compress(one.data) for one in arrays), squeeze.flush()])
    return MAGIC + struct.pack("<II", VERSION, len(said)) + said + data


def unpack(data: bytes) -> tuple[dict[str, Any], dict[str, Coded]]:
    """Inverse of `pack`. Raises ValueError that says what is wrong with ``data``; whatever it holds, no more than `MOST_DATA` bytes are
    made of it."""
    header, start = header_of(data)
    said = [description_of(one) for one in header["arrays"]]
    if len({one.name for one in said}) != len(said):
        raise ValueError("two arrays have one name")
    total = sum(map(bytes_of, said))
    if total > MOST_DATA:
        raise ValueError(f"it claims {total} bytes, more than this program reads")
    inflate = zlib.decompressobj()
    try:
        whole = inflate.decompress(data[start:], total + 1)
    except zlib.error as error:
        raise ValueError("its data are damaged") from error
    if len(whole) != total or not inflate.eof or inflate.unused_data:
        raise ValueError("its data are damaged or cut short")
    found, at = {}, 0
    for one in said:
        found[one.name] = replace(one, data=whole[at : at + bytes_of(one)])
        at += bytes_of(one)
    return header, found


def header_of(data: bytes) -> tuple[dict[str, Any], int]:
    """The header of a file alone, and where its compressed bytes begin. Raises ValueError that says what is wrong with it."""
    if data[:4] != MAGIC:
        raise ValueError("this is not a scene of the web player")
    if len(data) < 12:
        raise ValueError("the file is cut short")
    version, length = struct.unpack("<II", data[4:12])
    if version != VERSION:
        raise ValueError(f"its version is {version}, and this program reads version {VERSION}")
    if length > MOST_HEADER or len(data) < 12 + length:
        raise ValueError("the file is cut short")
    try:
        header = json.loads(data[12 : 12 + length])
    except (UnicodeDecodeError, ValueError, RecursionError) as error:
        raise ValueError("its header is damaged") from error
    if not isinstance(header, dict) or not isinstance(header.get("arrays"), list):
        raise ValueError("its header is damaged")
    return header, 12 + length
