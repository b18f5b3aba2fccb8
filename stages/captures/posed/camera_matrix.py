"""`K.txt`: known intrinsics of pictures without poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ....pipeline import CaptureError
from .. import checks

CAMERA_MATRIX = "K.txt"
_HALF = 0.23  # of a side: the principal point of a matrix for pictures of half or twice the size is this far from the middle, or more
LIMIT = 4096  # characters; nine numbers need a tenth of that


def read_camera_matrix(root: Path, name: str, width: int, height: int) -> np.ndarray | None:
    """[3,3] px from `K.txt`: known intrinsics from which structure from motion starts. None without the file."""
    path = root / name
    if not path.is_file():
        return None
    checks.resolve_inside(root, name, name)
    try:
        with path.open(encoding="utf-8") as file:
            values = [float(v) for v in file.read(LIMIT).split()]
    except (OSError, ValueError) as error:
        raise CaptureError(f"{name}: expected nine numbers, a 3x3 camera matrix ({error}); correct or remove the file") from error
    if len(values) != 9:
        raise CaptureError(f"{name}: expected nine numbers, a 3x3 camera matrix, found {len(values)}; correct or remove the file")
    K = checks.intrinsics(values[0], values[4], values[2], values[5], name, skew=values[1])
    if not (0 < K[0, 2] < width and 0 < K[1, 2] < height):
        raise CaptureError(
            f"{name}: the principal point {K[0, 2]:g}, {K[1, 2]:g} lies outside the {width}x{height} images; "
            "scale the matrix to the images or remove the file"
        )
    return K


def told(K: np.ndarray | None, name: str, width: int, height: int) -> tuple[str, ...]:
    """A line if the principal point is so far from the middle on both axes that ``K`` seems to be for pictures of another size."""
    if K is None or min(abs(K[0, 2] / width - 0.5), abs(K[1, 2] / height - 0.5)) < _HALF:
        return ()
    return (
        f"warning: {name}: the principal point {K[0, 2]:g}, {K[1, 2]:g} is far from the middle of the {width}x{height} pictures, as if the "
        f"matrix was made for about {2 * K[0, 2]:.0f}x{2 * K[1, 2]:.0f} px: then scale its first two rows to the pictures",
    )
