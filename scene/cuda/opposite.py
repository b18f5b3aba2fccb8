"""A comparison of images in front of the opposite background, for the kernels of the CPU and of the GPU."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


class Opposite(NamedTuple):
    """The same comparison in front of the opposite background, and that of alpha. alpha, known: of the render and of the capture, [H, W]
    float32; alpha receives gradients. kept: [H, W] bool, or None if all are; the others are equal in front of that background and their
    alpha does not count. change: RGB of the opposite background minus the one that was rendered. share: of the whole photometric loss.
    weight: of mean|alpha - known|."""

    alpha: Tensor
    known: Tensor
    kept: Tensor | None
    change: tuple[float, float, float]
    share: float
    weight: float
