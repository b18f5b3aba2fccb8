"""Six multi-resolution feature planes over space and time (HexPlane), which store the deformation field."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ... import _kernels
from .field_kernel import field_outputs
from .field_reference import lookup_reference

__all__ = ["HexPlanes", "lookup_reference"]


class HexPlanes(nn.Module):
    """Planes xy xz yz and xt yt zt at several spatial resolutions.

    Features are multiplied across the six planes of a level and concatenated across levels. Layout is channels-last, so that one
    look-up reads whole cache lines: ``space[l]`` is [3, R_l, R_l, C] (xy, xz, yz; the first coordinate varies fastest), ``time[l]``
    is [3, T, R_l, C]. Time planes start at one, so that the field starts independent of time. Space planes start uniform in
    [0.5, 1.5], so that products of six stay of order one, which the MLP can use.

    Args:
        resolutions: R of each level.
        times: T, samples along time; they span the whole interval [0, 1].
        channels: C, at most 64.
        seed: of the initial values.
    """

    def __init__(self, resolutions: tuple[int, ...] = (64, 128), times: int = 50, channels: int = 16, seed: int = 0) -> None:
        super().__init__()
        generator = torch.Generator().manual_seed(seed)
        self.space = nn.ParameterList([nn.Parameter(torch.rand(3, r, r, channels, generator=generator) + 0.5) for r in resolutions])
        self.time = nn.ParameterList([nn.Parameter(torch.ones(3, max(times, 1), r, channels)) for r in resolutions])
        self.channels = channels

    @property
    def features(self) -> int:
        """Width of the output, C times the number of levels."""
        return self.channels * len(self.space)

    def forward(self, u: Tensor, t: float) -> Tensor:
        """Features [N, C * levels] at positions ``u`` [N, 3] in [0, 1] (clamped, NaN to 0) and one time ``t`` in [0, 1] (likewise).

        Gradients reach only the planes: positions enter the field detached.
        """
        return field_outputs(list(self.space), list(self.time), [], u, None, t)

    def total_variation(self) -> Tensor:
        """L_tv of Eq. 9: mean squared difference of neighbours in space plus mean squared second difference in time, summed over planes."""
        planes = [*self.space, *self.time]
        if all(p.device.type == "cpu" and p.dtype == torch.float32 for p in planes):
            return _Smoothness.apply(len(self.space), *planes)
        if all(p.is_cuda and p.dtype == torch.float32 for p in planes):
            from ....rasterizer.cuda.runtime import launcher_for
            from ...cuda.smoothness import total_variation

            return total_variation(launcher_for(planes[0].device), list(self.space), list(self.time))
        return smoothness_reference(list(self.space), list(self.time))


def smoothness_reference(space: list[Tensor], time: list[Tensor]) -> Tensor:
    """`HexPlanes.total_variation` in plain torch, any float type and device: the oracle of the kernel."""
    differences = []
    for s, t in zip(space, time):
        differences += [s.diff(dim=1), s.diff(dim=2), t.diff(dim=2), t.diff(n=2, dim=1) if t.shape[1] > 2 else t[:, :0]]
    terms = [d.square().mean() for d in differences if d.numel()]
    return torch.stack(terms).sum() if terms else torch.zeros((), device=space[0].device)


class _Smoothness(torch.autograd.Function):
    @staticmethod
    def forward(ctx, levels: int, *planes: Tensor) -> Tensor:  # type: ignore[override]
        plain = [p.detach().contiguous() for p in planes]
        grads = [torch.empty_like(p) for p in plain]
        value = _kernels.smoothness(plain[:levels], plain[levels:], grads[:levels], grads[levels:], torch.get_num_threads())
        ctx.save_for_backward(*grads)
        return planes[0].new_tensor(value)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, grad: Tensor):  # type: ignore[override]
        return None, *(g * grad for g in ctx.saved_tensors)
