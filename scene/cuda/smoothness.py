"""Total variation of feature planes on the GPU: a torch.autograd.Function around the kernels of `smoothness.cu`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from ctypes import c_bool, c_float, c_int32
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ...rasterizer.cuda.runtime import Launcher
from .programs import program

PIECE = 256  # numbers of a row per block, as in smoothness.cu


def total_variation(launcher: Launcher, space: Sequence[Tensor], time: Sequence[Tensor]) -> Tensor:
    """`HexPlanes.total_variation`, a scalar on the launcher's device. The call does not synchronise.

    space: [3, R, R, C] of each level, time: [3, T, R, C] of each level; float32. Value and gradients are bit-equal from run to run.
    Raises ValueError for other shapes or types, and whatever `Launcher.launch` raises.
    """
    planes = [*space, *time]
    if not planes or any(p.ndim != 4 or p.shape[0] != 3 or not p.numel() for p in planes):
        raise ValueError(f"planes must be [3, rows, columns, channels], got {', '.join(str(list(p.shape)) for p in planes) or 'none'}")
    if any(p.dtype != torch.float32 for p in planes):
        raise ValueError(f"planes must be float32, got {', '.join(str(p.dtype) for p in planes)}")
    value: Tensor = _Smoothness.apply(launcher, len(space), *planes)
    return value


class _Smoothness(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, launcher: Launcher, levels: int, *planes: Tensor) -> Tensor:
        launches = list(_launches(levels, planes))
        parts = planes[0].new_empty(sum(blocks for _, blocks, _ in launches))
        for (plane, blocks, scalars), out in zip(launches, parts.split([blocks for _, blocks, _ in launches])):
            launcher.launch(program("smoothness"), "smoothness_value", blocks, PIECE, plane, *scalars, out)
        ctx.save_for_backward(*planes)
        ctx.launcher, ctx.levels = launcher, levels
        return parts.sum()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Any, ...]:
        gradients = []
        for plane, blocks, scalars in _launches(ctx.levels, ctx.saved_tensors):
            gradient = torch.empty_like(plane)
            inputs = (plane, *scalars, upstream.contiguous())
            ctx.launcher.launch(program("smoothness"), "smoothness_gradient", blocks, PIECE, *inputs, gradient)
            gradients.append(gradient)
        return None, None, *gradients


def _launches(levels: int, planes: Sequence[Tensor]) -> Iterator[tuple[Tensor, int, tuple[Any, ...]]]:
    """For each stack of planes: the tensor, the number of blocks, and the scalars rows, row, channels, second, along_row, along_column."""
    for k, plane in enumerate(planes):
        _, rows, columns, channels = plane.shape
        row, second = columns * channels, k >= levels
        across, down = 3 * rows * (columns - 1) * channels, 3 * (rows - (2 if second else 1)) * row  # numbers of differences
        weights = (c_float(1 / across if across > 0 else 0.0), c_float(1 / down if down > 0 else 0.0))
        shape = (c_int32(rows), c_int32(row), c_int32(channels), c_bool(second))
        yield plane.detach().contiguous(), 3 * rows * -(-row // PIECE), (*shape, *weights)
