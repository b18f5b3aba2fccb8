"""`Lens`: intrinsics and distortion of one camera, from a capture's files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

LARGEST_TERM = 100.0  # largest absolute value of a distortion term; undistortion later rejects lenses that are too strong for a picture


class Lens(NamedTuple):
    """K [3,3] px, pixel centres at +0.5, for the picture as stored. distortion: OpenCV's terms in OpenCV's order, k1 k2 p1 p2 or
    k1 k2 p1 p2 k3 k4 k5 k6 (Brown's model and its rational form), or k1 k2 k3 k4 of its fisheye model (Kannala and Brandt)."""

    K: np.ndarray
    distortion: np.ndarray
    fisheye: bool = False


def distortion_of(terms: Sequence[float]) -> np.ndarray:
    """[4] float64, or [8] if any term after the fourth is not zero."""
    return np.array([*terms, *[0.0] * (8 - len(terms))][: 8 if any(terms[4:]) else 4], dtype=np.float64)
