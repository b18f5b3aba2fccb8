"""Primitives at one moment of their lifetimes: the kernel, and its oracle in plain torch."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ... import _kernels
from ...rotation import compose, rotate
from .lifetime import Lifetime

Alive = tuple[Tensor, Tensor | None, Tensor]


def at_frame(points: Tensor, quats: Tensor | None, opacities: Tensor, life: Lifetime, dynamic: Tensor, frame: float | Tensor) -> Alive:
    """``points`` [N, K, 3], ``quats`` [N, 4] (w x y z, any norm; None for convexes) and ``opacities`` [N] at fractional ``frame``.

    A primitive that is ``dynamic`` [N] bool drifts and turns steadily; the K points of a convex turn about their mean. Its opacity is
    multiplied by exp(-age^2 / (2 span^2)), where age and span are in frames. The others stay as they are. Gradients reach everything except
    ``dynamic`` and ``frame``, a number or a tensor []. float32 on the CPU or on an NVIDIA GPU uses a kernel, anything else plain torch.
    """
    if points.device.type == "cpu" and points.dtype == torch.float32:
        turned_too = () if quats is None else (quats,)
        moved, shown, *turned = _AtFrame.apply(float(frame), dynamic, points, opacities, *life, *turned_too)
        return moved, turned[0] if turned else None, shown
    if points.is_cuda and points.dtype == torch.float32:
        from ....rasterizer.cuda.runtime import launcher_for
        from ...cuda.lives import at_frame as on_gpu

        return on_gpu(launcher_for(points.device), points, quats, opacities, life, dynamic, frame)
    return at_frame_reference(points, quats, opacities, life, dynamic, frame)


def at_frame_reference(
    points: Tensor, quats: Tensor | None, opacities: Tensor, life: Lifetime, dynamic: Tensor, frame: float | Tensor
) -> Alive:
    """`at_frame` in plain torch: the kernel's oracle in float64, and the implementation on other devices."""
    # Selected, so that whatever the life of the others holds, they get no gradient from it.
    life = Lifetime(*(p[dynamic] for p in life))
    age, present = frame - life.times, presence(life, frame)
    turns = turned_by(life.spins * age[:, None])
    rest = points[dynamic]
    moved = rest + (life.velocities * age[:, None])[:, None]
    if points.shape[1] > 1:
        arms = rest - rest.mean(1, keepdim=True)
        corners = turns.repeat_interleave(points.shape[1], 0)
        moved = moved + rotate(corners, arms.reshape(-1, 3)).reshape(arms.shape) - arms
    index = dynamic.nonzero()[:, 0]
    turned = None if quats is None else quats.index_copy(0, index, compose(turns, quats[dynamic]))
    return points.index_copy(0, index, moved), turned, opacities.index_copy(0, index, opacities[dynamic] * present)


def presence(life: Lifetime, frame: float | Tensor) -> Tensor:
    """[N] in [0, 1], the factor on opacities at ``frame``."""
    return torch.exp(-0.5 * ((frame - life.times) * torch.exp(-life.log_spans)).square())


def turned_by(vectors: Tensor) -> Tensor:
    """Unit quaternions [N, 4] (w x y z) of rotation vectors [N, 3], radians; smooth at zero."""
    half = 0.5 * vectors
    angle = half.square().sum(1, keepdim=True).clamp(min=1e-16).sqrt()
    return torch.cat([torch.cos(angle), half * (torch.sin(angle) / angle)], 1)


class _AtFrame(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, frame: float, dynamic: Tensor, *given: Tensor):  # type: ignore[override]
        points, opacities, *life = plain = [p.detach().contiguous() for p in given]
        quats = plain[6] if len(plain) > 6 else None
        moved, shown, turned = torch.empty_like(points), torch.empty_like(opacities), None if quats is None else torch.empty_like(quats)
        _kernels.lives_forward(points, quats, opacities, life[:4], dynamic, frame, moved, turned, shown, torch.get_num_threads())
        ctx.frame = frame
        ctx.save_for_backward(dynamic, *plain)
        return (moved, shown) if turned is None else (moved, shown, turned)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, g_moved: Tensor, g_shown: Tensor, *g_turned: Tensor):  # type: ignore[override]
        dynamic, points, opacities, *life = ctx.saved_tensors
        quats = life[4] if g_turned else None
        out = [torch.empty_like(p) for p in (points, opacities, *life)]
        grads = g_moved.contiguous(), g_turned[0].contiguous() if g_turned else None, g_shown.contiguous()
        given = points, quats, opacities, life[:4], dynamic, ctx.frame
        _kernels.lives_backward(*given, *grads, out[0], out[6] if g_turned else None, out[1], out[2:6], torch.get_num_threads())
        return None, None, *out
