"""PSNR near the edges of the ground truth: blur costs most there and hardly shows in a mean that includes flat areas."""

from __future__ import annotations

import numpy as np

from ..edges import edge_mask_canny, near_edges
from .images import as_pair
from .psnr import psnr

PIXELS = 2.0  # greatest distance from an edge that counts


def edge_psnr(image: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float | None:
    """PSNR in dB over pixels within 2 px (Euclidean) of a Canny edge of ``truth`` (quantised to 8 bits); None if there are no such pixels.

    image, truth: float [H, W, 3] in [0, 1]. mask: bool [H, W], the pixels that count; all if None.
    """
    image, truth = as_pair(image, truth)
    edges = edge_mask_canny(np.rint(np.clip(truth, 0.0, 1.0) * 255.0).astype(np.uint8))
    if not edges.any():
        return None
    near = near_edges(edges, PIXELS) if mask is None else near_edges(edges, PIXELS) & mask
    return psnr(image, truth, near) if near.any() else None
