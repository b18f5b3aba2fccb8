"""From the field's outputs to displacements: a rotation about the box's centre, a translation, a change of scale."""

from __future__ import annotations

import torch
from torch import Tensor

from ... import _kernels
from ...rotation import rotate
from .displacement import Displacement


def displace(heads: Tensor, rest: Tensor, centre: Tensor, reach: float) -> Displacement:
    """The displacement of ``rest`` [N, 3] by the field's outputs ``heads`` [N, 10].

    Columns 0-2 are a translation in units of ``reach`` (world units), 3-6 a rotation about ``centre`` [3] (w x y z, added to the
    identity, then normalised), and 7-9 are added to the logarithms of the scales. Gradients reach heads and rest. float32 on the CPU or on
    an NVIDIA GPU uses a kernel; anything else uses plain torch.
    """
    if all(p.device.type == "cpu" and p.dtype == torch.float32 for p in (heads, rest)):
        return Displacement(*_Displace.apply(heads, rest, tuple(centre.tolist()), reach))
    if all(p.is_cuda and p.dtype == torch.float32 for p in (heads, rest, centre)):
        from ....rasterizer.cuda.runtime import launcher_for
        from ...cuda.displace import displace as on_gpu

        return Displacement(*on_gpu(launcher_for(rest.device), heads, rest, centre, reach))
    turn = torch.cat([1 + heads[:, 3:4], heads[:, 4:7]], 1)
    turn = turn / turn.norm(dim=1, keepdim=True).clamp(min=1e-6)
    arm = rest - centre
    return Displacement(rotate(turn, arm) - arm + heads[:, :3] * reach, turn, heads[:, 7:10])


class _Displace(torch.autograd.Function):
    @staticmethod
    def forward(ctx, heads: Tensor, rest: Tensor, centre: tuple[float, float, float], reach: float):  # type: ignore[override]
        n = rest.shape[0]
        out = torch.empty(n, 3), torch.empty(n, 4), torch.empty(n, 3)
        plain = heads.detach().contiguous(), rest.detach().contiguous()
        _kernels.displacement_forward(*plain, centre, reach, *out, torch.get_num_threads())
        ctx.save_for_backward(heads, rest)
        ctx.centre, ctx.reach = centre, reach
        ctx.set_materialize_grads(False)
        return out

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, *grads: Tensor | None):  # type: ignore[override]
        heads, rest = (p.detach().contiguous() for p in ctx.saved_tensors)
        g_heads = torch.empty_like(heads)
        g_rest = torch.empty_like(rest) if ctx.needs_input_grad[1] else None
        given = [None if g is None else g.contiguous() for g in grads]
        _kernels.displacement_backward(heads, rest, ctx.centre, ctx.reach, *given, g_heads, g_rest, torch.get_num_threads())
        return g_heads, g_rest, None, None
