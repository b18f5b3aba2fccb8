"""Middlebury's .flo files: 202021.25, width, height, then u and v of each pixel, row by row; all little-endian, 32 bits.

The format is described in Baker et al. 2011 and on vision.middlebury.edu/flow. A file is not trusted until it has been checked.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...pipeline.files import write_atomically

MAGIC = 202021.25  # its bytes read "PIEH"
HEADER = 12  # bytes
LARGEST_SIDE = 99_999  # px, Middlebury's own limit
UNKNOWN = 1e10  # px, written where flow is unknown; readers treat everything beyond 1e9 as unknown


def write_flo(path: Path, flow: np.ndarray) -> None:
    """Writes ``flow``, float [H, W, 2] px (u right, v down), atomically. Vectors that are not finite are marked as unknown.

    Raises ValueError for another shape or dtype, OSError if the file cannot be written.
    """
    if flow.ndim != 3 or flow.shape[2] != 2 or not np.issubdtype(flow.dtype, np.floating):
        raise ValueError(f"{path}: expected flow as float [H, W, 2], got {flow.dtype} {list(flow.shape)}")
    height, width = flow.shape[:2]
    if not (0 < width <= LARGEST_SIDE and 0 < height <= LARGEST_SIDE):
        raise ValueError(f"{path}: flow of {width}x{height} does not fit into a .flo file; sides are 1 to {LARGEST_SIDE} px")
    values = flow.astype("<f4")
    values[~np.isfinite(values).all(-1)] = UNKNOWN
    header = np.array([MAGIC], "<f4").tobytes() + np.array([width, height], "<i4").tobytes()
    write_atomically(path, header + values.tobytes())


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
