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
FACTORS = 0xBF58476D1CE4E5B9 - 2**64, 0x94D049BB133111EB - 2**64


def keeps(dynamic: Tensor, share: float | Tensor, seed: int, step: int | Tensor) -> Tensor:
    """[N] bool: those that step ``step`` keeps. Each that is not ``dynamic`` [N] is left out with probability ``share``. It depends only
    on the numbers given, so that a resumed training leaves out the same. ``share`` and ``step`` may be tensors [] on the device of
    ``dynamic``, which a CUDA graph reads anew in each replay."""
    device = dynamic.device
    # Filled in, not copied there, for which the host would wait.
    numbers = [n if isinstance(n, Tensor) else torch.full((), n, dtype=torch.int64, device=device) for n in (step, seed)]
    drawn = torch.arange(len(dynamic), device=device).mul_(ROUND).add_(_mixed(numbers[0] * ROUND + _mixed(numbers[1])))
    drawn = drawn.bitwise_xor_((drawn >> 32).bitwise_and_(2**32 - 1)).mul_(FACTORS[0]) >> 40  # one round of `_mixed` will do
    return (drawn.bitwise_and_(2**24 - 1) >= 2**24 * share) | dynamic


def _mixed(number: Tensor) -> Tensor:
    """``number`` int64, scrambled: any bit that changes changes each other one half of the time (Stafford 2011, "Better bit mixing")."""
    for shift, factor in zip((30, 27, 31), (*FACTORS, 1)):
        number = (number ^ (number >> shift & (2 ** (64 - shift) - 1))) * factor
    return number


def thinned(gaussians: Gaussians, dynamic: Tensor, share: float | Tensor, keep: Tensor | None = None) -> Gaussians:
    """``gaussians`` of which only some are left: those that are not ``dynamic`` [N] are more opaque by 1 / (1 - ``share``), and those that
    ``keep`` [N] does not name are transparent; None: the others are not among them."""
    fuller = torch.where(dynamic, gaussians.opacities, (gaussians.opacities / (1 - share)).clamp(max=MOST_OPAQUE))
    return replace(gaussians, opacities=fuller if keep is None else fuller * keep)
