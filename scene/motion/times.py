"""Moments of a capture, as motions take them."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

Time = float | Tensor  # a moment in [0, 1]; a tensor [] on the device while a CUDA graph is captured, which is replayed for other moments

TOLERANCE = 1e-6  # beyond 0 and 1 that a time may lie, as sums of steps do


def check_time(t: Time) -> None:
    """Raises ValueError if ``t`` is a number outside [0, 1], or none. A tensor is not looked at: the host would wait for the device."""
    if not isinstance(t, Tensor) and not -TOLERANCE <= t <= 1 + TOLERANCE:
        raise ValueError(f"time {t:g}: a model has times from 0 (first of the capture) to 1 (last)")


def corrected(t: float, camera: int, clocks: Mapping[int, float]) -> float:
    """When a picture of camera number ``camera`` was taken whose file says ``t``: both in [0, 1]. clocks: see `Model`."""
    return min(max(t + clocks[camera], 0.0), 1.0) if camera in clocks else t


def together(times: list[Time]) -> list[float] | Tensor:
    """``times``, all floats or all tensors, as one tensor [T] if they are tensors."""
    tensors = [t for t in times if isinstance(t, Tensor)]
    return torch.stack(tensors) if tensors else [float(t) for t in times]
