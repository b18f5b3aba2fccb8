"""Draws a weight over a picture in one colour, to show edges and masks."""

from __future__ import annotations

import numpy as np

EDGE_COLOUR = (255, 40, 0)
MOVING_COLOUR = (0, 130, 255)
MASK_STRENGTH = 0.5  # a mask covers whole objects, which should stay visible


def overlay(image: np.ndarray, weight: np.ndarray, colour: tuple[int, int, int], strength: float = 1.0) -> np.ndarray:
    """``image`` (uint8 [H, W, 3] RGB) with ``colour`` where ``weight`` (uint8 [H, W]) is 255 and a blend below: uint8 [H, W, 3].

    strength in [0, 1]: the share of the colour at weight 255. Raises ValueError for other shapes or dtypes.
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise ValueError(f"image: expected uint8 [H, W, 3], got {image.dtype} {list(image.shape)}")
    if weight.shape != image.shape[:2] or weight.dtype != np.uint8:
        raise ValueError(f"weight: expected uint8 {list(image.shape[:2])} like the image, got {weight.dtype} {list(weight.shape)}")
    share = weight.astype(np.float32)[..., None] * (strength / 255)
    return np.rint(image + share * (np.array(colour, np.float32) - image)).astype(np.uint8)
