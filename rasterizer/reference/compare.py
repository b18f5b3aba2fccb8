"""Tools for comparing two renders: which pixels are decided by a threshold, and gradients of a scalar.

At some pixels, rounding decides on which side of a threshold a value lies: an alpha within a rounding error of 1/255 or of the cap, a
transmittance at the stop, two layers at the same depth. There, both results are correct and may differ by as much as one layer.
Everywhere else they agree tightly.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..types import Camera, Frame
from ..uniform import cast, no_convexes, no_gaussians, pad_extras
from .blend import MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE, effective_alphas
from .convexes import Shapes, convex_alphas, project_convexes
from .gaussians import Splats, gaussian_alphas, project_gaussians
from .render import pixel_centres
from .scene import Scene

ALPHA_BAND = 2e-5  # absolute
STOP_BAND = 1e-3  # relative
DEPTH_BAND = 1e-6  # relative
OUTPUTS = ("color", "alpha", "depth", "extras")


@torch.no_grad()
def projected(scene: Scene) -> tuple[Camera, Splats, Shapes]:
    """The scene's camera and its projected primitives from the reference, in float64 and without extras."""
    camera = cast(scene.camera, torch.float64)
    gaussians = cast(scene.gaussians or no_gaussians(camera.K.dtype, camera.K.device), torch.float64)
    convexes = cast(scene.convexes or no_convexes(camera.K.dtype, camera.K.device), torch.float64)
    gaussians, convexes = pad_extras(replace(gaussians, extras=None), replace(convexes, extras=None))
    return camera, project_gaussians(camera, gaussians, scene.antialiased), project_convexes(camera, convexes, scene.antialiased)


def raw_alphas(scene: Scene) -> tuple[Tensor, Tensor]:
    """Alphas [H W, n] before the cap and the cutoff at 1/255, and depths [n], front to back, from the reference."""
    camera, splats, shapes = projected(scene)
    with torch.no_grad():
        pixels = pixel_centres(camera)
        depths = torch.cat([splats.depths, shapes.depths])
        order = torch.argsort(depths, stable=True)
        return torch.cat([gaussian_alphas(splats, pixels), convex_alphas(shapes, camera, pixels)], 1)[:, order], depths[order]


def decided_by_threshold(
    scene: Scene, alpha_band: float = ALPHA_BAND, stop_band: float = STOP_BAND, depth_band: float = DEPTH_BAND
) -> Tensor:
    """[H, W] bool: pixels where some primitive is so close to a threshold (within the band) that rounding may decide."""
    raw, depths = raw_alphas(scene)
    _, blended = effective_alphas(raw)
    capped = raw.clamp(max=MAX_ALPHA)
    after = torch.cumprod(1 - torch.where(raw >= MIN_ALPHA, capped, 0.0), dim=1)  # as if no pixel ever stopped
    before = torch.cat([torch.ones_like(after[:, :1]), after], 1)[:, :-1]
    reached = before >= MIN_TRANSMITTANCE * (1 - stop_band)  # layers behind the stop do not matter
    near = ((raw - MIN_ALPHA).abs() < alpha_band) | ((raw - MAX_ALPHA).abs() < alpha_band)
    near |= (raw >= MIN_ALPHA) & ((after / MIN_TRANSMITTANCE - 1).abs() < stop_band)
    undecided = (near & reached).any(1)
    ties = (depths[1:] - depths[:-1]) < depth_band * depths[1:]
    undecided |= (blended[:, 1:] & blended[:, :-1] & ties).any(1)
    return undecided.reshape(scene.camera.height, scene.camera.width)


def cotangents(frame: Frame, ignore: Tensor | None = None, seed: int = 0, outputs: tuple[str, ...] = OUTPUTS) -> dict[str, Tensor]:
    """Reproducible random weights for a scalar loss on each output; zero at the pixels in `ignore` [H, W]."""
    g = torch.Generator().manual_seed(seed)
    found = {}
    for name in outputs:
        weights = torch.randn(getattr(frame, name).shape, generator=g, dtype=torch.float64)
        if ignore is not None:
            weights[ignore] = 0
        found[name] = weights
    return found


def weigh(frame: Frame, weights: dict[str, Tensor]) -> Tensor:
    """The scalar sum over all outputs of weights * output, in the precision of the outputs."""
    return torch.stack([(getattr(frame, name) * w.to(getattr(frame, name).dtype)).sum() for name, w in weights.items()]).sum()


def gradients(scene: Scene, backend: str, weights: dict[str, Tensor]) -> dict[str, Tensor]:
    """Gradients of `weigh` with respect to every input of the scene; a gradient of None becomes zeros."""
    leaves = scene.leaves()
    weigh(scene.having(leaves).render(backend), weights).backward()
    return {name: torch.zeros_like(leaf) if leaf.grad is None else leaf.grad for name, leaf in leaves.items()}


def relative_l2(got: Tensor, want: Tensor) -> float:
    """|got - want| / |want| in float64. If want is zero: 0 if got is zero too, else infinity."""
    a, b = got.detach().double(), want.detach().double()
    size, distance = float(b.norm()), float((a - b).norm())
    return distance / size if size else (0.0 if distance == 0 else float("inf"))
