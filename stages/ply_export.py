"""A model as numbered PLY files, and how far these are from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..rasterizer import Gaussians
    from ..scene.model import Model
    from .frameset import FrameSet

SPREADS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0)  # of a convex's points: standard deviations of the Gaussian for it, of which the best is taken
LOOKS = 4  # views that judge


@dataclass
class Exported:
    """fewest, most: Gaussians of a file. convexes: how many became Gaussians. psnr: dB between renders with these and with the convexes."""

    fewest: int
    most: int
    convexes: int
    psnr: float | None


def export_ply(model: Model, frames: FrameSet, folder: Path, count: int, advance: Callable[[int], None] = lambda n: None) -> Exported:
    """``folder/frame0001.ply`` and so on: the Gaussians of ``model`` at ``count`` times from first to last (the middle one, if one)."""
    import torch

    from ..scene.ply import as_gaussians, joined, write_ply

    folder.mkdir(parents=True, exist_ok=True)
    spread, psnr = best_spread(model, frames) if len(model.convexes) else (1.0, None)
    rows = []
    for k, t in enumerate(np.linspace(0, 1, count) if count > 1 else [0.5]):
        with torch.no_grad():
            gaussians, convexes = model.at(float(t))
            rows.append(write_ply(folder / f"frame{k + 1:04d}.ply", joined(gaussians, as_gaussians(convexes, spread))))
        advance(1)
    return Exported(min(rows), max(rows), len(model.convexes), psnr)


def best_spread(model: Model, frames: FrameSet) -> tuple[float, float]:
    """Of `SPREADS` the one whose renders are nearest to those of the full ``model`` over a few training views, and its PSNR, dB."""
    import torch

    from ..rasterizer import Camera, rasterize
    from ..scene.ply import as_gaussians, joined

    assert frames.K is not None and frames.cam_from_world is not None
    chosen = frames.train[np.linspace(0, len(frames.train) - 1, min(LOOKS, len(frames.train))).round().astype(int)]
    background = torch.tensor(model.background)
    errors = np.zeros(len(SPREADS))
    for i in chosen:
        K, pose = (torch.tensor(a[i], dtype=torch.float32) for a in (frames.K, frames.cam_from_world))
        camera = Camera(K, pose, frames.width, frames.height, model.near)
        with torch.no_grad():
            gaussians, convexes = model.at(float(frames.time[i]))
            truth = rasterize(camera, gaussians, convexes, background).color.clamp(0, 1)
            for s, spread in enumerate(SPREADS):
                baked: Gaussians = joined(gaussians, as_gaussians(convexes, spread))
                color = rasterize(camera, baked, None, background).color.clamp(0, 1)
                errors[s] += float((color - truth).square().mean()) / len(chosen)
    best = int(errors.argmin())
    return SPREADS[best], float(-10 * np.log10(max(errors[best], 1e-10)))
