"""Reads depth and confidence of Record3D, `.depth` and `.conf`: plain numbers row by row, compressed by Apple's LZFSE, without their shape.

Facts from github.com/marek-simonik/record3d and, for the blocks of a compressed file, github.com/lzfse/lzfse.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

from ..images.files import MOST_BYTES, MOST_PIXELS, BadImageError

PACKED = (".depth", ".conf")
SHAPE = 0.05  # share by which the ratio of the sides may differ from that of the picture
_TYPES: dict[str, np.dtype[Any]] = {".depth": np.dtype("<f4"), ".conf": np.dtype("u1")}
_LONGEST = 2**14


def read_packed(path: Path, shape: tuple[int, int]) -> np.ndarray:
    """[h, w] float32 metres, or uint8 confidence (0 to 2), with about the ratio of ``shape``. Raises BadImageError."""
    import lzfse

    dtype = _TYPES[path.suffix.lower()]
    if not path.is_file() or path.stat().st_size > MOST_BYTES:
        raise BadImageError(f"it is not a file, or has more than {MOST_BYTES >> 30} GiB")
    data = path.read_bytes()
    promised = promised_bytes(data)
    if not 0 < promised <= MOST_PIXELS * dtype.itemsize:
        raise BadImageError(f"{promised} bytes are promised")
    try:
        plain = lzfse.decompress(data)
    except Exception as error:
        raise BadImageError(f"it is not compressed by LZFSE ({str(error) or type(error).__name__})") from error
    count = len(plain) // dtype.itemsize
    # The rows that give the ratio of the picture best.
    tall = [h for h in range(1, min(count, _LONGEST) + 1) if count % h == 0]
    off = {h: abs(count / h / h * shape[0] / shape[1] - 1) for h in tall}
    height = min(off, key=lambda h: off[h]) if off else 0
    if len(plain) % dtype.itemsize or not off or off[height] >= SHAPE:
        raise BadImageError(f"its {count} values of {dtype.itemsize} bytes have no shape like the picture's {shape[1]}x{shape[0]}")
    return np.frombuffer(plain, dtype).reshape(height, -1)


def promised_bytes(data: bytes) -> int:
    """How many bytes the blocks of ``data`` say that they hold: what is decompressed is bounded before memory is taken. Raises
    BadImageError if the blocks do not follow one another to an end."""
    at = total = 0
    try:
        while (magic := data[at : at + 4]) != b"bvx$":
            (raw,) = struct.unpack_from("<I", data, at + 4)
            if magic == b"bvx2":
                first, second, third = struct.unpack_from("<3Q", data, at + 8)
                size = (third & 0xFFFFFFFF) + (first >> 20 & 0xFFFFF) + (second >> 40 & 0xFFFFF)
            elif magic == b"bvxn":
                size = 12 + struct.unpack_from("<I", data, at + 8)[0]
            elif magic == b"bvx-":
                size = 8 + raw
            else:  # bvx1 is not written by Apple's encoder
                raise BadImageError("it is not compressed by LZFSE")
            at, total = at + max(size, 8), total + raw
    except struct.error as error:
        raise BadImageError("its blocks have no end") from error
    return total
