"""Primitives at one moment of their lifetimes on the GPU: a torch.autograd.Function around the kernels of `lives.cu`."""

from __future__ import annotations

from ctypes import c_float, c_int32
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ...rasterizer.cuda.runtime import Launcher
from ..motion.lifetimes.lifetime import Lifetime
from .inputs import check
from .programs import program

THREADS = 128


def at_frame(
    launcher: Launcher, points: Tensor, quats: Tensor | None, opacities: Tensor, life: Lifetime, dynamic: Tensor, frame: float | Tensor
) -> tuple[Tensor, Tensor | None, Tensor]:
    """`scene.motion.lifetimes.at_frame`: ``points`` [N, K, 3], ``quats`` [N, 4] or None and ``opacities`` [N] at ``frame``. float32 and, of
    ``dynamic`` [N], bool, on the launcher's device; the call does not synchronise. ``frame``: a number, or a tensor [] there, which a CUDA
    graph reads anew in each replay.

    Gradients reach everything except dynamic and frame, and are bit-equal from run to run. Raises ValueError for other shapes or types,
    and whatever `Launcher.launch` raises.
    """
    n = len(opacities)
    shapes = {"points": (points, (n, max(1, points.shape[1]) if points.ndim == 3 else 1, 3)), "quats": (quats, (n, 4))}
    of_life = zip(life._asdict().items(), ((n,), (n,), (n, 3), (n, 3)), strict=True)
    own = {"opacities": (opacities, (n,)), "dynamic": (dynamic, (n,))}
    check(shapes | own | {name: (value, shape) for (name, value), shape in of_life}, dynamic=torch.bool)
    flat = (points, opacities, *life, *(() if quats is None else (quats,)))
    moved, shown, *turned = _Live.apply(launcher, frame, dynamic.contiguous(), *flat)
    return moved, turned[0] if turned else None, shown


class _Live(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, launcher: Launcher, frame: float | Tensor, dynamic: Tensor, *given: Tensor) -> tuple[Tensor, ...]:
        points, opacities, *life = (p.detach().contiguous() for p in given)
        quats = life.pop() if len(life) > 4 else None
        inputs = _inputs(points, quats, opacities, life, dynamic, frame)
        moved, shown = torch.empty_like(points), torch.empty_like(opacities)
        turned = None if quats is None else torch.empty_like(quats)
        launcher.launch(program("lives"), "live", -(-len(points) // THREADS), THREADS, *inputs, moved, turned, shown)
        ctx.save_for_backward(dynamic, points, quats, opacities, *life)
        ctx.launcher, ctx.frame = launcher, frame
        ctx.set_materialize_grads(False)
        return (moved, shown) if turned is None else (moved, shown, turned)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, g_moved: Tensor | None, g_shown: Tensor | None, g_turned: Tensor | None = None) -> tuple[Any, ...]:
        dynamic, points, quats, opacities, *life = ctx.saved_tensors
        inputs = _inputs(points, quats, opacities, life, dynamic, ctx.frame)
        grads = (None if g is None else g.contiguous() for g in (g_moved, g_turned, g_shown))
        out = [None if p is None else torch.empty_like(p) for p in (points, quats, opacities, *life)]
        ctx.launcher.launch(program("lives"), "live_backward", -(-len(points) // THREADS), THREADS, *inputs, *grads, *out)
        of_points, of_quats, *others = out
        return None, None, None, of_points, *others, *(() if of_quats is None else (of_quats,))


def _inputs(
    points: Tensor, quats: Tensor | None, opacities: Tensor, life: list[Tensor], dynamic: Tensor, frame: float | Tensor
) -> tuple[Any, ...]:
    """The arguments that both kernels begin with."""
    when = (c_float(0.0), frame) if isinstance(frame, Tensor) else (c_float(frame), None)
    return c_int32(points.shape[0]), c_int32(points.shape[1]), points, quats, opacities, *life, dynamic, *when
