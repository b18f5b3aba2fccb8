"""Reads Middlebury's .flo files, which the product only writes: its exports, and published truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from e4dgs.vision.flow.flo import HEADER, LARGEST_SIDE, MAGIC


def read_flo(path: Path) -> np.ndarray:
    """Reads a .flo file: float32 [H, W, 2] px. Unknown vectors have components beyond 1e9, or NaN if the file holds NaN.

    Nothing is allocated until the size in the header agrees with the size of the file. Raises ValueError that names the file and what is
    wrong with it, OSError if it cannot be read.
    """
    path = Path(path)
    if not path.is_file():  # a pipe or a device would block
        raise ValueError(f"{path}: there is no such file" if not path.exists() else f"{path}: this is not a file; name a .flo file")
    with open(path, "rb") as file:
        size = path.stat().st_size
        head = file.read(HEADER)
        if len(head) < HEADER:
            raise ValueError(f"{path}: {size} bytes are too few for a .flo file, whose header alone has {HEADER}; copy it again")
        if head[:4] != np.array([MAGIC], "<f4").tobytes():
            raise ValueError(f"{path}: this is not a .flo file: it begins with {head[:4]!r} and not with b'PIEH'; is it another format?")
        width, height = (int(side) for side in np.frombuffer(head, "<i4", 2, 4))
        if not (0 < width <= LARGEST_SIDE and 0 < height <= LARGEST_SIDE):
            raise ValueError(f"{path}: its header says {width}x{height}, and sides are 1 to {LARGEST_SIDE} px; the file is damaged")
        expected = HEADER + 8 * width * height
        if size != expected:
            raise ValueError(f"{path}: {width}x{height} take {expected} bytes and the file has {size}; copy it again, it is cut or damaged")
        values = np.fromfile(file, "<f4", 2 * width * height)
    if values.size != 2 * width * height:
        raise ValueError(f"{path}: it became shorter while it was read; copy it again")
    return values.reshape(height, width, 2).astype(np.float32, copy=False)
