"""Draws the edges of a render and those of the ground truth in one picture."""

from __future__ import annotations

import numpy as np

from ....scene.edges import edge_mask_canny, near_edges
from .edge_colours import ADDED, BOTH, MISSING

SAME = 1.0  # px, distance up to which an edge of one picture and an edge of the other count as the same
GROUND = (20, 23, 26)


def edges_picture(render: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Contours in the colours of `edge_colours.py`: uint8 [H, W, 3] RGB.

    render, truth: uint8 [H, W, 3] RGB at display size, so that contours stay one pixel wide. The Canny thresholds are those of
    `edge_psnr`. An edge at most `SAME` px from an edge of the other picture counts as in both, and is drawn where the truth has it.
    """
    there, drawn = edge_mask_canny(truth), edge_mask_canny(render)
    picture = np.full(truth.shape, GROUND, np.uint8)
    picture[drawn & ~near_edges(there, SAME)] = ADDED
    picture[there] = MISSING
    picture[there & near_edges(drawn, SAME)] = BOTH
    return picture
