"""The check that every metric applies to its two images."""

from __future__ import annotations

import numpy as np


def as_pair(image: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both images as float64 [H, W, 3]. The caller must pass values in [0, 1]; this is not checked.

    Raises ValueError if the shapes differ or are not [H, W, 3] with H, W > 0, or if a value is not finite, as the metric would be NaN.
    """
    pair = []
    for name, value in (("image", image), ("truth", truth)):
        array = np.asarray(value)
        if array.ndim != 3 or array.shape[2] != 3 or array.size == 0:
            raise ValueError(f"{name}: expected [H, W, 3] with H, W > 0, got {list(array.shape)}")
        if array.dtype == np.uint8:
            raise ValueError(f"{name}: expected floats in [0, 1], got uint8; divide by 255")
        array = array.astype(np.float64)
        if not np.isfinite(array).all():
            raise ValueError(f"{name}: {int((~np.isfinite(array)).sum())} values are not finite")
        pair.append(array)
    if pair[0].shape != pair[1].shape:
        raise ValueError(f"image {list(pair[0].shape)} and truth {list(pair[1].shape)} differ in shape")
    return pair[0], pair[1]
