"""Features of the six planes on the GPU: a torch.autograd.Function around the kernels of `field.cu` and `field_backward.cu`."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_float, c_int32
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ...rasterizer.cuda.runtime import Argument, Launcher
from ..motion.planes.field_reference import lookup_reference
from .programs import program

MOST_LEVELS, MOST_CHANNELS = 4, 64
THREADS = 256
BACK_THREADS = 128
BACK_BLOCKS = 512  # at most: each block first sums the gradients of the lines on its own, then adds these sums to the result
LINE_QUADS = 2496  # of all lines, so that their sums fit into a block's 48 KiB of shared memory together with the rest


def takes(space: Sequence[Tensor]) -> bool:
    """Whether the kernels support planes with this number of levels and channels."""
    channels = space[0].shape[-1] if space else 0
    return 1 <= len(space) <= MOST_LEVELS and 1 <= channels <= MOST_CHANNELS and channels % 4 == 0


def look_up(
    launcher: Launcher, space: Sequence[Tensor], time: Sequence[Tensor], points: Tensor, box: tuple[Tensor, Tensor] | None, t: float
) -> Tensor:
    """Features [N, levels * C]; see `field_outputs` for the arguments. float32 on the launcher's device; the call does not synchronise.

    Gradients go to the planes. They are sums over points in no fixed order. With `torch.use_deterministic_algorithms(True)` plain torch
    computes them instead; its indexing sorts before it adds, so they are bit-equal from run to run, but this takes some hundred launches a
    level, each over all points, and temporarily about 20 C numbers of memory a point and level.

    A CUDA graph keeps the time that it was captured with. Raises ValueError for shapes and types that the kernels do not support, and
    whatever `Launcher.launch` raises.
    """
    _check(space, time, points)
    corners = (None, None) if box is None else tuple(_plain(corner.detach().to(points.device, torch.float32)) for corner in box)
    features: Tensor = _LookUp.apply(launcher, len(space), points.detach(), *corners, t, *space, *time)
    return features


class _LookUp(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, launcher: Launcher, levels: int, points: Tensor, low: Tensor | None, high: Tensor | None, t: float, *planes: Tensor
    ) -> Tensor:
        points, plain = _plain(points), [_plain(p) for p in planes]
        n, channels = points.shape[0], plain[0].shape[3]
        rows = [3 * p.shape[1] for p in plain[:levels]]
        lines = points.new_empty(sum(rows), channels)
        look = program("field", channels=channels, levels=levels)
        times = (*_four(plain[levels:]), *_sizes(plain[levels:]), *_sizes(plain[:levels]))
        launcher.launch(look, "blend_lines", -(-lines.numel() // (4 * THREADS)), THREADS, c_float(t), *times, lines)
        features = points.new_empty(n, levels * channels)
        each = THREADS // (channels // 4)
        space = (*_four(plain[:levels]), *_sizes(plain[:levels]))
        launcher.launch(look, "look_up", -(-n // each), THREADS, c_int32(n), points, low, high, *space, lines, features)
        ctx.launcher, ctx.levels, ctx.t = launcher, levels, t
        ctx.save_for_backward(points, low, high, lines, *planes)
        return features

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Any, ...]:
        points, low, high, lines, *planes = ctx.saved_tensors
        given = None, None, None, None, None, None
        if torch.are_deterministic_algorithms_enabled():
            u = points if low is None else (points - low) / (high - low)
            return *given, *_in_order(u, ctx.t, ctx.levels, planes, grad)
        levels, n, channels = ctx.levels, points.shape[0], lines.shape[1]
        space, time = [_plain(p) for p in planes[:levels]], planes[levels:]
        sums = points.new_zeros(sum(p.numel() for p in space) + lines.numel())  # one allocation for all; the kernel adds to them
        *flat, line_grads = sums.split([*(p.numel() for p in space), lines.numel()])
        quads = -(-lines.numel() // 256) * 64  # programs differ by whole KiB only
        back = program("field_backward", channels=channels, levels=levels, lines=quads if quads <= LINE_QUADS else 0)
        blocks = min(-(-n // (BACK_THREADS // (channels // 4))), BACK_BLOCKS)
        inputs = (c_int32(n), points, low, high, *_four(space), *_sizes(space), lines, _plain(grad))
        ctx.launcher.launch(back, "look_up_backward", blocks, BACK_THREADS, *inputs, *_four(flat), line_grads)
        time_grads = [torch.empty_like(p, memory_format=torch.contiguous_format) for p in time]
        spread = -(-sum(p.numel() for p in time) // (4 * THREADS))
        sizes = (*_sizes(time), *_sizes(space))
        ctx.launcher.launch(back, "spread_lines", spread, THREADS, c_float(ctx.t), *sizes, line_grads, *_four(time_grads))
        return *given, *(g.view_as(p) for g, p in zip(flat, space)), *time_grads


def _in_order(u: Tensor, t: float, levels: int, planes: Sequence[Tensor], grad: Tensor) -> tuple[Tensor, ...]:
    """The gradients of the planes, computed by plain torch."""
    with torch.enable_grad():
        leaves = [p.detach().requires_grad_() for p in planes]
        features = lookup_reference(u, t, *[p for pair in zip(leaves[:levels], leaves[levels:]) for p in pair])
        return torch.autograd.grad(features, leaves, grad)


def _check(space: Sequence[Tensor], time: Sequence[Tensor], points: Tensor) -> None:
    if not takes(space):
        raise ValueError(f"planes have 1 to {MOST_LEVELS} levels of 4, 8, ... or {MOST_CHANNELS} channels; got {_shapes(space)}")
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points must be [N, 3], got {list(points.shape)}")
    channels = space[0].shape[3]
    fits = len(space) == len(time) and all(
        s.shape == (3, s.shape[1], s.shape[1], channels) and p.shape == (3, p.shape[1], s.shape[1], channels) and s.numel() and p.numel()
        for s, p in zip(space, time)
    )
    if not fits:
        raise ValueError(f"space must be [3, R, R, C] and time [3, T, R, C] of each level; got {_shapes(space)} and {_shapes(time)}")
    if any(p.dtype != torch.float32 for p in (points, *space, *time)):
        raise ValueError("points and planes must be float32")


def _shapes(tensors: Sequence[Tensor]) -> str:
    return ", ".join(str(list(p.shape)) for p in tensors) or "none"


def _plain(tensor: Tensor) -> Tensor:
    """Contiguous and aligned to 16 bytes."""
    tensor = tensor.detach().contiguous()
    return tensor if tensor.data_ptr() % 16 == 0 else tensor.clone()


def _four(tensors: Sequence[Tensor]) -> list[Argument]:
    """Kernel arguments for one tensor per level, padded with None to `MOST_LEVELS`."""
    return [*tensors, *[None] * (MOST_LEVELS - len(tensors))]


def _sizes(planes: Sequence[Tensor]) -> list[Argument]:
    """Kernel arguments for R of space planes or T of time planes, padded with 0."""
    return [*(c_int32(p.shape[1]) for p in planes), *(c_int32(0) for _ in range(MOST_LEVELS - len(planes)))]
