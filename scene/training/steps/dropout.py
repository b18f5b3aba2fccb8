"""Leaves Gaussians out of a training step at random, so that none can rely on others to hide it: what only fits the training views
together does not last, and views from elsewhere improve.

As DropGaussian (Park et al. 2025) does for few views: the share grows from 0, and those that remain are more opaque by as much, so that the
expected opacity stays. Gaussians that move are never left out: they are present in few steps as it is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from ....rasterizer import Gaussians

MOST_OPAQUE = 0.999


def keeps(dynamic: Tensor, share: float, seed: int, step: int) -> Tensor:
    """[N] bool: those that step ``step`` keeps. Each that is not ``dynamic`` [N] is left out with probability ``share``. It depends only
    on the numbers given, so that a resumed training leaves out the same."""
    draw = np.random.default_rng((seed, 9, step)).random(len(dynamic), dtype=np.float32)
    # Not blocking: the host must not wait for a GPU in each step.
    return torch.from_numpy(draw >= share).to(dynamic.device, non_blocking=True) | dynamic


def thinned(gaussians: Gaussians, dynamic: Tensor, share: float, keep: Tensor | None = None) -> Gaussians:
    """``gaussians`` of which only some are left: those that are not ``dynamic`` [N] are more opaque by 1 / (1 - ``share``), and those that
    ``keep`` [N] does not name are transparent; None: the others are not among them."""
    fuller = torch.where(dynamic, gaussians.opacities, (gaussians.opacities / (1 - share)).clamp(max=MOST_OPAQUE))
    return replace(gaussians, opacities=fuller if keep is None else fuller * keep)
