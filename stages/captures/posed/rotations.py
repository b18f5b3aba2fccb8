"""Rotations from the quaternions of capture files."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ....pipeline import CaptureError


def rotation(quaternion: Sequence[float] | np.ndarray, where: str) -> np.ndarray:
    """[3,3] float64 of a quaternion w, x, y, z of any norm. Raises CaptureError for NaN, Inf and a norm of zero."""
    q = np.array(quaternion, dtype=np.float64)
    norm = float(np.linalg.norm(q))
    if not np.isfinite(q).all() or norm < 1e-6:
        raise CaptureError(f"{where}: holds NaN, Inf or a zero quaternion; remove the image or estimate its pose again")
    w, x, y, z = q / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
