"""What is rendered of primitives, from what is learned, on the GPU: a torch.autograd.Function around the kernels of `looks.cu`."""

from __future__ import annotations

from ctypes import c_int32
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ...rasterizer.cuda.runtime import Launcher
from .inputs import check
from .programs import program

PRIMITIVES = 128  # of a block, which has as many threads

Looks = tuple[tuple[Tensor, ...], Tensor, Tensor]


def look(
    launcher: Launcher,
    logs: tuple[Tensor, ...],
    logits: Tensor,
    dc: Tensor,
    rest: Tensor,
    shown: int,
    shades: Tensor | None,
    light: Tensor | None,
) -> Looks:
    """`PrimitiveSet.activated` of N primitives: exp of ``logs``, sigmoid of ``logits`` and [N, 1 + shown, 3] coefficients of colour. The
    call does not synchronise.

    logs: one tensor [N, W] or [N], and perhaps another [N]. logits: [N]. dc: [N, 1, 3]. rest: [N, R, 3], of which the first ``shown`` are
    used. shades: [N, 3] and light: [3]; without the latter, which may be None, the former are not used. All float32 on the launcher's
    device. Gradients reach all that is used and are bit-equal from run to run.

    Raises ValueError for other shapes or types, and whatever `Launcher.launch` raises.
    """
    n = len(logits)
    others = logs[1] if len(logs) > 1 else None
    if len(logs) > 2 or rest.ndim != 3 or not 0 <= shown <= rest.shape[1] or (light is not None and shades is None):
        raise ValueError(f"logs must be one or two, rest [N, R, 3] with R of {shown} or more, and shades there with a light")
    of_logs = {"logs": (logs[0], (n, *logs[0].shape[1:2])), "other logs": (others, (n,)), "logits": (logits, (n,))}
    of_colour = {"dc": (dc, (n, 1, 3)), "rest": (rest, (n, rest.shape[1], 3)), "shades": (shades, (n, 3)), "light": (light, (3,))}
    check(of_logs | of_colour)
    used = (logs[0], others, logits, dc, rest if shown else None, None if light is None else shades, light)
    sizes, other_sizes, opacities, sh = _Look.apply(launcher, shown, *used)
    return (sizes,) if other_sizes is None else (sizes, other_sizes), opacities, sh


class _Look(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, launcher: Launcher, shown: int, *given: Tensor | None) -> tuple[Tensor | None, ...]:
        inputs = [None if p is None else p.detach().contiguous() for p in given]
        logs, others, logits, dc, rest, shades, light = inputs
        assert logs is not None and logits is not None and dc is not None
        n = len(logits)
        counts = [c_int32(count) for count in (n, logs.numel() // max(n, 1), 0 if rest is None else rest.shape[1], shown)]
        sizes, opacities, sh = torch.empty_like(logs), torch.empty_like(logits), dc.new_empty(n, 1 + shown, 3)
        other_sizes = None if others is None else torch.empty_like(others)
        blocks = -(-n // PRIMITIVES)
        launcher.launch(program("looks"), "look", blocks, PRIMITIVES, *counts, *inputs, sizes, other_sizes, opacities, sh)
        ctx.launcher, ctx.counts, ctx.blocks, ctx.rest_shape = launcher, counts, blocks, None if rest is None else rest.shape
        ctx.save_for_backward(logs, others, logits, dc, shades, light)
        ctx.set_materialize_grads(False)
        return sizes, other_sizes, opacities, sh

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Any, ...]:
        logs, others, logits, dc, shades, light = inputs = ctx.saved_tensors
        g_sizes, g_others, g_opacities, g_sh = incoming = [None if g is None else g.contiguous() for g in grads]
        # None rather than zeros where nothing comes in: autograd would add these up.
        pairs = ((logs, g_sizes), (others, g_others), (logits, g_opacities), (dc, g_sh))
        by_rows = [None if g is None else torch.empty_like(p) for p, g in pairs]
        d_rest = None if ctx.rest_shape is None or g_sh is None else dc.new_empty(ctx.rest_shape)
        lit = light is not None and g_sh is not None
        d_shades, d_light = (torch.empty_like(shades), light.new_empty(ctx.blocks, 3)) if lit else (None, None)
        arguments = (*ctx.counts, *inputs, *incoming, *by_rows, d_rest, d_shades, d_light)
        ctx.launcher.launch(program("looks"), "look_backward", ctx.blocks, PRIMITIVES, *arguments)
        return None, None, *by_rows, d_rest, d_shades, d_light.sum(0) if d_light is not None else None
