"""Depth from slanted windows: PatchMatch (Bleyer et al. 2011) between one image and several others whose poses are known.

A plane sweep compares windows of equal depth, but floors and walls that are seen at an angle have none. Here each pixel has a plane of its
own, takes over those of its neighbours if they fit better, and changes its own at random.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .. import _kernels

ITERATIONS = 3


def refine(
    image: np.ndarray,
    others: Sequence[np.ndarray],
    to: np.ndarray,
    best: int,
    inverse: np.ndarray,
    limits: tuple[float, float],
    steps: int,
    focal: float,
    iterations: int = ITERATIONS,
    wanted: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Improved inverse depth [h, w] of ``image``, 1 / world units, and the correlation [h, w] that it reaches, in [-1, 1].

    image, others: grey levels [h, w] float32. to [N, 3, 4]: the pixel (x, y) with inverse depth v lies at to[j] (x, y, 1, v) in others[j],
    times its depth there. best: how many of the others count, those that agree best. inverse [h, w]: the first guess. limits: of inverse
    depth. steps: how many steps of about one pixel they span. focal: px. wanted [h, w] bool: the pixels that count; the others keep their
    depth, and their correlation is -1. Equal for any number of threads.
    """
    h, w = image.shape
    planes = np.zeros((3, h, w), np.float32)
    planes[0] = inverse
    score = np.empty((h, w), np.float32)
    step = (limits[1] - limits[0]) / max(steps - 1, 1)
    pictures = np.ascontiguousarray(np.stack(others), np.float32)
    plain = np.ascontiguousarray(image, np.float32), pictures, np.ascontiguousarray(to, np.float32)
    _kernels.patch_match(*plain, best, limits, step, focal, iterations, wanted, planes, score, 1)
    return planes[0], score
