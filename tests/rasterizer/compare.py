"""How two renders, and two sets of gradients, are compared.

An image has pixels that a threshold decides: an alpha a rounding error away from 1/255 or from the cap, a transmittance at the
stop, two layers at the same depth. There both answers are right, and they may differ by as much as one layer. Everywhere else
they agree tightly. So the comparison has layers: tight outside those pixels, a capped share of flips inside, a check for bias over
all that is compared tightly. Pixels that a threshold decides are few, which is checked too; else the tight part would be empty.
"""

from __future__ import annotations

import torch
from e4dgs.rasterizer import Frame
from e4dgs.rasterizer.reference.compare import OUTPUTS, cotangents, gradients, weigh
from torch import Tensor

from .thresholds import decided_by_threshold, raw_alphas

__all__ = [
    "OUTPUTS",
    "assert_gradients_close",
    "assert_images_close",
    "cotangents",
    "decided_by_threshold",
    "gradients",
    "raw_alphas",
    "weigh",
]


def assert_images_close(
    got: Frame,
    want: Frame,
    decided: Tensor,
    tolerance: float = 2e-5,
    max_decided: float = 0.05,
    flip: float = 0.05,
    max_flips: float = 0.01,
) -> None:
    """Compare color, alpha, depth and extras, each relative to the largest value of `want` (at least 1).

    Outside `decided` [H, W] nothing differs by more than `tolerance`, and the mean signed difference of no channel exceeds a
    tenth of it. Inside, at most a share `max_flips` of all pixels differs by more than `tolerance`, none by more than `flip`, which
    for depth is taken times alpha.
    """
    share = float(decided.double().mean())
    assert share <= max_decided, f"thresholds decide {share:.1%} of the pixels, more than {max_decided:.1%}: too few are left to compare"
    for name in ("color", "alpha", "depth", "extras"):
        a, b = getattr(got, name).detach().double(), getattr(want, name).detach().double()
        assert a.shape == b.shape, f"{name} has shape {list(a.shape)}, expected {list(b.shape)}"
        if b.numel() == 0:
            continue
        difference = ((a - b) / max(1.0, float(b.abs().max()))).reshape(*decided.shape, -1)
        assert bool(torch.isfinite(difference).all()), f"{name} is not finite"
        outside, inside = difference[~decided], difference[decided]
        if outside.numel():
            worst = float(outside.abs().max())
            assert worst <= tolerance, f"{name} differs by {worst:.2e} outside the thresholds' pixels, more than {tolerance:.0e}"
            bias = float(outside.mean(0).abs().max())
            assert bias <= tolerance / 10, f"{name} is biased by {bias:.2e}, more than {tolerance / 10:.0e}"
        if inside.numel():
            flips = float((inside.abs() > tolerance).any(-1).sum()) / decided.numel()
            assert flips <= max_flips, f"{name} flips at {flips:.2%} of the pixels, more than {max_flips:.2%}"
            if name == "depth":  # a faint layer that is all there is brings its whole depth with it
                inside = inside * torch.maximum(got.alpha, want.alpha).detach().double()[decided][:, None]
            worst = float(inside.abs().max())
            assert worst <= flip, f"{name} differs by {worst:.2e} where a threshold decides, more than {flip:.0e}"


def assert_gradients_close(
    got: dict[str, Tensor], want: dict[str, Tensor], relative: float = 1e-3, cosine: float = 1e-6, bias: float = 1e-3
) -> None:
    """Compare gradients by name: relative L2 distance, 1 - cosine, and the signed sum of the difference over the sum of |want|.

    A gradient that is zero in `want` must be zero in `got`.
    """
    assert got.keys() == want.keys(), f"gradients of {sorted(got)}, expected {sorted(want)}"
    for name, b in want.items():
        a, b = got[name].detach().double().flatten(), b.detach().double().flatten()
        assert a.shape == b.shape, f"{name}: {a.numel()} gradients, expected {b.numel()}"
        assert bool(torch.isfinite(a).all()), f"gradient of {name} is not finite"
        size = float(b.norm())
        if size == 0:
            assert float(a.abs().max() if a.numel() else 0) == 0, f"gradient of {name} must be zero"
            continue
        distance = float((a - b).norm()) / size
        assert distance <= relative, f"gradient of {name} is off by {distance:.2e} in relative L2, more than {relative:.0e}"
        angle = 1 - float(a @ b) / max(float(a.norm()) * size, 1e-300)
        assert angle <= cosine, f"gradient of {name} points elsewhere: 1 - cosine = {angle:.2e}, more than {cosine:.0e}"
        signed = float((a - b).sum().abs()) / float(b.abs().sum())
        assert signed <= bias, f"gradient of {name} is biased by {signed:.2e}, more than {bias:.0e}"
