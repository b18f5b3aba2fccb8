"""Six feature planes over space and time (HexPlane), multi-resolution: the memory of the deformation field."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from . import _kernels

SPACE_AXES = ((0, 1), (0, 2), (1, 2))  # xy, xz, yz


class HexPlanes(nn.Module):
    """Planes xy xz yz and xt yt zt at several spatial resolutions.

    Features are multiplied across the six planes of a level and concatenated across levels. Layout is channels-last, so that one
    look-up reads whole cache lines: ``space[l]`` is [3, R_l, R_l, C] (xy, xz, yz; the first coordinate varies fastest), ``time[l]``
    is [3, T, R_l, C]. Time planes start at one, so that the field begins independent of time; space planes start uniform in
    [0.5, 1.5]: products of six stay of order one, so the MLP sees features that it can use.

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

        Gradients reach the planes only: positions enter the field detached (design, section 1).
        """
        parameters = [p for pair in zip(self.space, self.time) for p in pair]
        if u.device.type == "cpu" and u.dtype == torch.float32:
            return _PlaneLookup.apply(u.detach().contiguous(), float(t), *parameters)
        return lookup_reference(u.detach(), float(t), *parameters)

    def total_variation(self) -> Tensor:
        """L_tv of Eq. 9: mean squared difference of neighbours in space plus mean squared second difference in time, summed over planes."""
        differences = []
        for space, time in zip(self.space, self.time):
            differences += [
                space.diff(dim=1),
                space.diff(dim=2),
                time.diff(dim=2),
                time.diff(n=2, dim=1) if time.shape[1] > 2 else time[:, :0],
            ]
        terms = [d.square().mean() for d in differences if d.numel()]
        return torch.stack(terms).sum() if terms else torch.zeros(())


def _taps(u: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor]:
    x = u.nan_to_num(0).clamp(0, 1) * (count - 1)
    low = x.long().clamp(max=max(count - 2, 0))
    return low, (low + 1).clamp(max=count - 1), (x - low).to(u.dtype)


def lookup_reference(u: Tensor, t: float, *parameters: Tensor) -> Tensor:
    """The look-up in plain torch, any float type and device: the oracle of the kernel."""
    out = []
    for space, time in zip(parameters[0::2], parameters[1::2]):
        r = space.shape[1]
        taps = [_taps(u[:, axis], r) for axis in range(3)]
        low, high, f = _taps(torch.tensor([t], dtype=u.dtype, device=u.device), time.shape[1])
        lines = time[:, int(low)] * (1 - f) + time[:, int(high)] * f
        feature = torch.ones(u.shape[0], space.shape[3], dtype=u.dtype, device=u.device)
        for plane, (a, b) in enumerate(SPACE_AXES):
            (la, ha, fa), (lb, hb, fb) = taps[a], taps[b]
            fa, fb = fa[:, None], fb[:, None]
            grid = space[plane]
            feature = feature * (
                grid[lb, la] * (1 - fa) * (1 - fb) + grid[lb, ha] * fa * (1 - fb) + grid[hb, la] * (1 - fa) * fb + grid[hb, ha] * fa * fb
            )
        for axis in range(3):
            la, ha, fa = taps[axis]
            feature = feature * (lines[axis][la] * (1 - fa[:, None]) + lines[axis][ha] * fa[:, None])
        out.append(feature)
    return torch.cat(out, dim=1)


class _PlaneLookup(torch.autograd.Function):
    @staticmethod
    def forward(ctx, u: Tensor, t: float, *parameters: Tensor) -> Tensor:  # type: ignore[override]
        channels = parameters[0].shape[3]
        out = torch.empty(u.shape[0], channels * (len(parameters) // 2))
        for level, (space, time) in enumerate(zip(parameters[0::2], parameters[1::2])):
            _kernels.planes_forward(space.detach(), time.detach(), u, t, out, level * channels, torch.get_num_threads())
        ctx.save_for_backward(u, *parameters)
        ctx.t = t
        return out

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, grad: Tensor):  # type: ignore[override]
        u, *parameters = ctx.saved_tensors
        grad = grad.contiguous()
        gradients: list[Tensor] = []
        for level, (space, time) in enumerate(zip(parameters[0::2], parameters[1::2])):
            grad_space, grad_time = torch.zeros_like(space), torch.zeros_like(time)
            offset = level * space.shape[3]
            _kernels.planes_backward(space.detach(), time.detach(), u, ctx.t, grad, offset, grad_space, grad_time, torch.get_num_threads())
            gradients += [grad_space, grad_time]
        return None, None, *gradients
