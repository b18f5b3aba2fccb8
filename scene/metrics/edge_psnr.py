"""PSNR where the ground truth has edges: blur costs most there and is invisible in a mean over flat areas."""

from __future__ import annotations

import numpy as np

from ..edges import edge_mask_canny, near_edges
from .images import as_pair
from .psnr import psnr

PIXELS = 2.0  # distance from an edge that still counts


def edge_psnr(image: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float | None:
    """PSNR in dB over pixels within 2 px (Euclidean) of a Canny edge of ``truth`` (quantised to 8 bits); None where it has no edge.

    image, truth: float [H, W, 3] in [0, 1]. mask: bool [H, W], the pixels that count, all without one.
    """
    image, truth = as_pair(image, truth)
    edges = edge_mask_canny(np.rint(np.clip(truth, 0.0, 1.0) * 255.0).astype(np.uint8))
    if not edges.any():
        return None
    near = near_edges(edges, PIXELS) if mask is None else near_edges(edges, PIXELS) & mask
    return psnr(image, truth, near) if near.any() else None
