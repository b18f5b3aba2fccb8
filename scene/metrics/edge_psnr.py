"""PSNR where the ground truth has edges: blur costs most there and is invisible in a mean over flat areas."""

from __future__ import annotations

import numpy as np

from ..edges import edge_mask_canny, near_edges
from .images import as_pair
from .psnr import psnr

PIXELS = 2.0  # distance from an edge that still counts


def edge_psnr(image: np.ndarray, truth: np.ndarray) -> float | None:
    """PSNR in dB over pixels within 2 px (Euclidean) of a Canny edge of ``truth`` (quantised to 8 bits); None where it has no edge.

    image, truth: float [H, W, 3] in [0, 1].
    """
    image, truth = as_pair(image, truth)
    edges = edge_mask_canny(np.rint(np.clip(truth, 0.0, 1.0) * 255.0).astype(np.uint8))
    return psnr(image, truth, near_edges(edges, PIXELS)) if edges.any() else None
