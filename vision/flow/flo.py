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
