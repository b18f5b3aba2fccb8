"""The costly part of the deformation field: six-plane look-up, product, concatenation and a perceptron, forward and backward."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from ... import _kernels
from .field_reference import lookup_reference


def field_outputs(
    space: Sequence[Tensor], time: Sequence[Tensor], weights: Sequence[Tensor], points: Tensor, box: tuple[Tensor, Tensor] | None, t: float
) -> Tensor:
    """``W3 relu(W2 relu(W1 f + b1) + b2) + b3`` [N, O] of the planes' features f [N, levels * C]; f itself where ``weights`` is empty.

    Args:
        space: of each level, [3, R, R, C] (xy, xz, yz; the first coordinate varies fastest).
        time: of each level, [3, T, R, C] (xt, yt, zt).
        weights: W1 [W, levels * C], b1 [W], W2 [W, W], b2 [W], W3 [O, W], b3 [O].
        points: [N, 3] positions (clamped to the box, NaN to its low face). They carry no gradient.
        box: low and high corner [3] that the planes cover; None for the unit box.
        t: time in [0, 1] (clamped, NaN to 0), one for all positions.

    float32 on the CPU uses one kernel, whose result and gradients are bit-equal for any number of threads. float32 on an NVIDIA GPU uses
    kernels for the features and torch's layers, which use TF32 if torch is configured to. Anything else uses plain torch. Second
    derivatives are not supported, and asking for them is an error.
    """
    tensors = [*space, *time, *weights]
    if all(p.device.type == "cpu" and p.dtype == torch.float32 for p in (points, *tensors)):
        corners = ((0.0,) * 3, (1.0,) * 3) if box is None else (box[0].tolist(), box[1].tolist())
        keep = torch.is_grad_enabled() and any(p.requires_grad for p in tensors)
        return _Field.apply(len(space), points.detach().contiguous(), corners, float(t), keep, *tensors)
    features = _features(space, time, points.detach(), box, float(t))
    if not weights:
        return features
    w1, b1, w2, b2, w3, b3 = weights
    return F.linear(F.relu(F.linear(F.relu(F.linear(features, w1, b1)), w2, b2)), w3, b3)


def _features(space: Sequence[Tensor], time: Sequence[Tensor], points: Tensor, box: tuple[Tensor, Tensor] | None, t: float) -> Tensor:
    if all(p.is_cuda and p.dtype == torch.float32 for p in (points, *space, *time)):
        from ....rasterizer.cuda.runtime import launcher_for
        from ...cuda.field import look_up, takes

        if takes(space):
            return look_up(launcher_for(points.device), space, time, points, box, t)
    u = points if box is None else (points - box[0]) / (box[1] - box[0])
    return lookup_reference(u, t, *[p for pair in zip(space, time) for p in pair])


class _Field(torch.autograd.Function):
    @staticmethod
    def forward(ctx, levels: int, points: Tensor, box, t: float, keep: bool, *tensors: Tensor) -> Tensor:  # type: ignore[override]
        space, time, weights = _split(levels, [p.detach().contiguous() for p in tensors])
        n = points.shape[0]
        out = torch.empty(n, weights[4].shape[0] if weights else levels * space[0].shape[3])
        padded = -(-weights[0].shape[0] // 16) * 16 if weights else 0
        hidden = torch.empty(2 * n * padded) if keep else None
        _kernels.field_forward(space, time, weights, points, box, t, out, hidden, torch.get_num_threads())
        if hidden is not None:
            ctx.save_for_backward(points, hidden, *tensors)
        ctx.box, ctx.t, ctx.levels = box, t, levels
        return out

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, grad: Tensor):  # type: ignore[override]
        points, hidden, *tensors = ctx.saved_tensors
        inputs = _split(ctx.levels, [p.detach().contiguous() for p in tensors])
        gradients = [torch.empty_like(p) for p in tensors]
        threads = torch.get_num_threads()
        _kernels.field_backward(*inputs, points, ctx.box, ctx.t, grad.contiguous(), hidden, *_split(ctx.levels, gradients), threads)
        return None, None, None, None, None, *gradients


def _split(levels: int, tensors: list[Tensor]) -> tuple[list[Tensor], list[Tensor], list[Tensor]]:
    return tensors[:levels], tensors[levels : 2 * levels], tensors[2 * levels :]
