"""The edges of a render against those of the ground truth, in one picture."""

from __future__ import annotations

import numpy as np

from ...scene.edges import edge_mask_canny, near_edges
from .edge_colours import ADDED, BOTH, MISSING

SAME = 1.0  # px between an edge of the one and an edge of the other that count as one
GROUND = (20, 23, 26)


def edges_picture(render: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Contours in the colours of `edge_colours.py`: uint8 [H, W, 3] RGB.

    render, truth: uint8 [H, W, 3] RGB of the size in which they are shown, so that contours stay one pixel wide. Canny's thresholds are
    those of `edge_psnr`. An edge at most `SAME` px from one of the other picture is in both, and drawn where the truth has it.
    """
    there, drawn = edge_mask_canny(truth), edge_mask_canny(render)
    picture = np.full(truth.shape, GROUND, np.uint8)
    picture[drawn & ~near_edges(there, SAME)] = ADDED
    picture[there] = MISSING
    picture[there & near_edges(drawn, SAME)] = BOTH
    return picture
