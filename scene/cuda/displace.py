"""From the field's outputs to displacements on the GPU: a torch.autograd.Function around the kernels of `displace.cu`."""

from __future__ import annotations

from ctypes import c_float, c_int32
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ...rasterizer.cuda.runtime import Launcher
from .inputs import check
from .programs import program

THREADS = 128


def displace(launcher: Launcher, heads: Tensor, rest: Tensor, centre: Tensor, reach: float) -> tuple[Tensor, Tensor, Tensor]:
    """The parts of a `Displacement` of ``rest`` [N, 3] by ``heads`` [N, 10]. float32 on the launcher's device; the call
    does not synchronise.

    Gradients reach heads and rest and are bit-equal from run to run. Raises ValueError for other shapes or types, and whatever
    `Launcher.launch` raises.
    """
    check({"heads": (heads, (len(rest), 10)), "rest": (rest, (len(rest), 3)), "centre": (centre, (3,))})
    return _Displace.apply(launcher, heads, rest, centre.detach().contiguous(), reach)


class _Displace(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, launcher: Launcher, heads: Tensor, rest: Tensor, centre: Tensor, reach: float) -> tuple[Tensor, Tensor, Tensor]:
        n = rest.shape[0]
        out = rest.new_empty(n, 3), rest.new_empty(n, 4), rest.new_empty(n, 3)
        inputs = (c_int32(n), heads.detach().contiguous(), rest.detach().contiguous(), centre, c_float(reach))
        launcher.launch(program("displace"), "displace", -(-n // THREADS), THREADS, *inputs, *out)
        ctx.save_for_backward(heads, rest, centre)
        ctx.launcher, ctx.reach = launcher, reach
        ctx.set_materialize_grads(False)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Any, ...]:
        heads, rest, centre = (p.detach().contiguous() for p in ctx.saved_tensors)
        g_heads = torch.empty_like(heads)
        g_rest = torch.empty_like(rest) if ctx.needs_input_grad[2] else None
        n = rest.shape[0]
        inputs = (c_int32(n), heads, rest, centre, c_float(ctx.reach), *(None if g is None else g.contiguous() for g in grads))
        ctx.launcher.launch(program("displace"), "displace_backward", -(-n // THREADS), THREADS, *inputs, g_heads, g_rest)
        return None, g_heads, g_rest, None, None
