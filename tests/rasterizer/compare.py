"""How two renders, and two sets of gradients, are compared.

An image has pixels that a threshold decides: an alpha a rounding error away from 1/255 or from the cap, a transmittance at the
stop, two layers at the same depth. There both answers are right, and they may differ by as much as one layer. Everywhere else
they agree tightly. So the comparison has layers: tight outside those pixels, a capped share of flips inside, a check for bias over
all that is compared tightly. Pixels that a threshold decides are few, which is checked too; else the tight part would be empty.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from e4dgs.rasterizer import Frame
from e4dgs.rasterizer.rasterize import _cast, _empty_convexes, _empty_gaussians, _pad_extras
from e4dgs.rasterizer.reference.blend import MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE, effective_alphas
from e4dgs.rasterizer.reference.convexes import convex_alphas, project_convexes
from e4dgs.rasterizer.reference.gaussians import gaussian_alphas, project_gaussians
from e4dgs.rasterizer.reference.render import pixel_centres
from torch import Tensor

from .scenes import Scene, generator

ALPHA_BAND = 2e-5  # absolute
STOP_BAND = 1e-3  # relative
DEPTH_BAND = 1e-6  # relative


def raw_alphas(scene: Scene) -> tuple[Tensor, Tensor]:
    """Alphas before cap and cut [H W, n] and depths [n], front to back, from the reference."""
    with torch.no_grad():
        camera = _cast(scene.camera, torch.float64)
        gaussians = _cast(scene.gaussians or _empty_gaussians(camera), torch.float64)
        convexes = _cast(scene.convexes or _empty_convexes(camera), torch.float64)
        gaussians, convexes = _pad_extras(replace(gaussians, extras=None), replace(convexes, extras=None))
        splats, shapes = project_gaussians(camera, gaussians), project_convexes(camera, convexes)
        pixels = pixel_centres(camera)
        depths = torch.cat([splats.depths, shapes.depths])
        order = torch.argsort(depths, stable=True)
        return torch.cat([gaussian_alphas(splats, pixels), convex_alphas(shapes, camera, pixels)], 1)[:, order], depths[order]


def decided_by_threshold(
    scene: Scene, alpha_band: float = ALPHA_BAND, stop_band: float = STOP_BAND, depth_band: float = DEPTH_BAND
) -> Tensor:
    """[H, W] bool: pixels where some primitive is within a band of a threshold, so that rounding may decide."""
    raw, depths = raw_alphas(scene)
    _, blended = effective_alphas(raw)
    capped = raw.clamp(max=MAX_ALPHA)
    after = torch.cumprod(1 - torch.where(raw >= MIN_ALPHA, capped, 0.0), dim=1)  # as if no pixel ever stopped
    before = torch.cat([torch.ones_like(after[:, :1]), after], 1)[:, :-1]
    reached = before >= MIN_TRANSMITTANCE * (1 - stop_band)  # layers behind the stop decide nothing
    near = ((raw - MIN_ALPHA).abs() < alpha_band) | ((raw - MAX_ALPHA).abs() < alpha_band)
    near |= (raw >= MIN_ALPHA) & ((after / MIN_TRANSMITTANCE - 1).abs() < stop_band)
    undecided = (near & reached).any(1)
    ties = (depths[1:] - depths[:-1]) < depth_band * depths[1:]
    undecided |= (blended[:, 1:] & blended[:, :-1] & ties).any(1)
    return undecided.reshape(scene.camera.height, scene.camera.width)


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
    tenth of it. Inside, at most a share `max_flips` of all pixels differs by more than `tolerance`, none by more than `flip`.
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


OUTPUTS = ("color", "alpha", "depth", "extras")


def cotangents(frame: Frame, ignore: Tensor | None = None, seed: int = 0, outputs: tuple[str, ...] = OUTPUTS) -> dict[str, Tensor]:
    """Fixed random weights for a scalar loss on each output, zero at the pixels `ignore` [H, W]."""
    g = generator(seed)
    found = {}
    for name in outputs:
        weights = torch.randn(getattr(frame, name).shape, generator=g, dtype=torch.float64)
        if ignore is not None:
            weights[ignore] = 0
        found[name] = weights
    return found


def weigh(frame: Frame, weights: dict[str, Tensor]) -> Tensor:
    """The scalar sum over outputs of weights . output, in the output's precision."""
    return torch.stack([(getattr(frame, name) * w.to(getattr(frame, name).dtype)).sum() for name, w in weights.items()]).sum()


def gradients(scene: Scene, backend: str, weights: dict[str, Tensor]) -> dict[str, Tensor]:
    """Gradients of `weigh` with respect to every input of the scene; None becomes zeros."""
    leaves = scene.leaves()
    weigh(scene.having(leaves).render(backend), weights).backward()
    return {name: torch.zeros_like(leaf) if leaf.grad is None else leaf.grad for name, leaf in leaves.items()}
