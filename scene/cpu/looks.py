"""What is rendered of primitives, from what is learned, on the CPU: a torch.autograd.Function around one kernel.

In plain torch this is a dozen small operations, which in small scenes take longer than their arithmetic.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from .. import _kernels

Looks = tuple[tuple[Tensor, ...], Tensor, Tensor]


def look(
    logs: tuple[Tensor, ...], logits: Tensor, dc: Tensor, rest: Tensor, shown: int, shades: Tensor | None, light: Tensor | None
) -> Looks:
    """`PrimitiveSet.activated` of N primitives: exp of ``logs``, sigmoid of ``logits`` and [N, 1 + shown, 3] coefficients of colour.

    logs: one tensor [N, W] or [N], and perhaps another [N]. logits: [N]. dc: [N, 1, 3]. rest: [N, R, 3], of which the first ``shown`` are
    used. shades: [N, C] and light: [C]; without the latter, which may be None, the former are not used. All float32 on the CPU. Gradients
    reach all that is used and are bit-equal for any number of threads. Raises ValueError for other shapes.
    """
    others = logs[1] if len(logs) > 1 else None
    of_light = (None, None) if light is None else (shades, light)
    sizes, other_sizes, opacities, sh = _Look.apply(shown, logs[0], others, logits, dc, rest, *of_light)
    return (sizes,) if other_sizes is None else (sizes, other_sizes), opacities, sh


class _Look(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, shown: int, *given: Tensor | None) -> tuple[Tensor | None, ...]:
        inputs = [None if p is None else p.detach().contiguous() for p in given]
        logs, others, logits, dc, *_ = inputs
        assert logs is not None and logits is not None and dc is not None
        other_sizes = None if others is None else torch.empty_like(others)
        out = torch.empty_like(logs), other_sizes, torch.empty_like(logits), dc.new_empty(len(logits), 1 + shown, 3)
        _kernels.looks_forward(inputs, shown, out, torch.get_num_threads())
        ctx.shown = shown
        ctx.save_for_backward(*inputs, *out)
        ctx.set_materialize_grads(False)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Any, ...]:
        saved = ctx.saved_tensors
        inputs, out = saved[:7], saved[7:]
        sizes, other_sizes, opacities, sh = incoming = [None if g is None else g.contiguous() for g in grads]
        # None rather than zeros where nothing comes in: autograd would add these up.
        comes_in = sizes, other_sizes, opacities, sh, sh if ctx.shown else None, sh, sh
        back = [None if p is None or g is None else torch.empty_like(p) for p, g in zip(inputs, comes_in)]
        _kernels.looks_backward(inputs, ctx.shown, out, incoming, back, torch.get_num_threads())
        return None, *back
