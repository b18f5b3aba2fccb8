"""The look-up in the six planes in plain torch: the oracle of the kernels."""

from __future__ import annotations

import torch
from torch import Tensor

SPACE_AXES = ((0, 1), (0, 2), (1, 2))  # xy, xz, yz


def _taps(u: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor]:
    x = u.nan_to_num(0).clamp(0, 1) * (count - 1)
    low = x.long().clamp(max=max(count - 2, 0))
    return low, (low + 1).clamp(max=count - 1), (x - low).to(u.dtype)


def lookup_reference(u: Tensor, t: float, *parameters: Tensor) -> Tensor:
    """The look-up in plain torch, any float type and device: the oracle of the kernel.

    ``parameters``: space and time of each level in turn.
    """
    out = []
    for space, time in zip(parameters[0::2], parameters[1::2]):
        r = space.shape[1]
        taps = [_taps(u[:, axis], r) for axis in range(3)]
        low, high, here = _taps(torch.tensor([t], dtype=u.dtype), time.shape[1])
        f = torch.full_like(here, float(here), device=u.device)  # filled on the device, so that nothing waits for it
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
