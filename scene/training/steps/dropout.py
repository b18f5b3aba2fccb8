"""Leaves Gaussians out of a training step at random, so that none can rely on others to hide it: what only fits the training views
together does not last, and views from elsewhere improve.

As DropGaussian (Park et al. 2025) does for few views: the share grows from 0, and those that remain are more opaque by as much, so that the
expected opacity stays. Gaussians that move are never left out: they are present in few steps as it is.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ....rasterizer import Gaussians

MOST_OPAQUE = 0.999
ROUND = 0x9E3779B97F4A7C15 - 2**64  # odd, and far from any simple fraction of 2^64


def keeps(dynamic: Tensor, share: float | Tensor, seed: int, step: int | Tensor) -> Tensor:
    """[N] bool: those that step ``step`` keeps. Each that is not ``dynamic`` [N] is left out with probability ``share``. It depends only
    on the numbers given, so that a resumed training leaves out the same. ``share`` and ``step`` may be tensors [] on the device of
    ``dynamic``, which a CUDA graph reads anew in each replay."""
    row = torch.arange(len(dynamic), device=dynamic.device)
    drawn = _mixed(_mixed(row + _times_round(step)) + _times_round(seed)) & (2**24 - 1)
    return (drawn >= 2**24 * share) | dynamic


def _times_round(number: int | Tensor) -> int | Tensor:
    """``number`` times `ROUND`, of 64 bits."""
    return number * ROUND if isinstance(number, Tensor) else (number * ROUND + 2**63) % 2**64 - 2**63


def _mixed(numbers: Tensor) -> Tensor:
    """``numbers`` int64, scrambled: any bit that changes changes each other one half of the time (Stafford 2011, "Better bit mixing")."""
    for shift, factor in ((30, 0xBF58476D1CE4E5B9 - 2**64), (27, 0x94D049BB133111EB - 2**64), (31, 1)):
        numbers = (numbers ^ (numbers >> shift & (2 ** (64 - shift) - 1))) * factor
    return numbers


def thinned(gaussians: Gaussians, dynamic: Tensor, share: float | Tensor, keep: Tensor | None = None) -> Gaussians:
    """``gaussians`` of which only some are left: those that are not ``dynamic`` [N] are more opaque by 1 / (1 - ``share``), and those that
    ``keep`` [N] does not name are transparent; None: the others are not among them."""
    fuller = torch.where(dynamic, gaussians.opacities, (gaussians.opacities / (1 - share)).clamp(max=MOST_OPAQUE))
    return replace(gaussians, opacities=fuller if keep is None else fuller * keep)
