"""A model as Gaussians alone, for tools that know no convexes, and how far that is from the model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .capture_cameras import camera_of, distinct_views

if TYPE_CHECKING:
    from ..rasterizer import Gaussians
    from ..scene.model import Model
    from .frameset import FrameSet

SPREADS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0)  # of a convex's points: standard deviations of the Gaussian for it, of which the best is taken
LOOKS = 4  # views that judge


@dataclass
class Baked:
    """``model`` with Gaussians for its convexes. spread: their standard deviations in those of a convex's points."""

    model: Model
    spread: float = 1.0

    def at(self, t: float) -> Gaussians:
        """The Gaussians, with sh, at time ``t`` in [0, 1]: always as many, in the same order."""
        import torch

        from ..scene.ply import as_gaussians, joined

        with torch.no_grad():
            gaussians, convexes = self.model.at(t)
            return joined(gaussians, as_gaussians(convexes, self.spread))


@dataclass
class Loss:
    """psnr: dB between renders of what was exported and of the full model, over ``cameras`` cameras. convexes: became Gaussians."""

    psnr: float
    cameras: int
    convexes: int

    def __str__(self) -> str:
        said = f"{self.psnr:.1f} dB from the full model, first time, {self.cameras} cameras"
        return f"{self.convexes} convexes became Gaussians: {said}" if self.convexes else said


def bake(model: Model, frames: FrameSet) -> Baked:
    """Of `SPREADS` the one whose renders are nearest to those of the full ``model`` over a few training views."""
    if not len(model.convexes):
        return Baked(model)
    chosen = frames.train[np.linspace(0, len(frames.train) - 1, min(LOOKS, len(frames.train))).round().astype(int)]
    errors = [sum(squared_error(Baked(model, s), frames, int(i), float(frames.time[i])) for i in chosen) for s in SPREADS]
    return Baked(model, SPREADS[int(np.argmin(errors))])


def loss_of(model: Model, gaussians: Gaussians, frames: FrameSet, t: float) -> Loss:
    """How far ``gaussians`` are from ``model`` at time ``t``, over cameras that training did not see, where these are enough."""
    chosen = distinct_views(frames, np.concatenate([frames.test, frames.val]), LOOKS)
    if len(chosen) < LOOKS:
        chosen = distinct_views(frames, np.concatenate([frames.test, frames.val, frames.train]), LOOKS)
    error = sum(squared_error_of(model, gaussians, frames, int(i), t) for i in chosen) / len(chosen)
    return Loss(float(-10 * np.log10(max(error, 1e-10))), len(chosen), len(model.convexes))


def squared_error(baked: Baked, frames: FrameSet, i: int, t: float) -> float:
    return squared_error_of(baked.model, baked.at(t), frames, i, t)


def squared_error_of(model: Model, gaussians: Gaussians, frames: FrameSet, i: int, t: float) -> float:
    """Mean squared difference in [0, 1] between renders of ``gaussians`` and of ``model`` from the camera of frame ``i`` at time ``t``."""
    import torch

    from ..rasterizer import rasterize

    camera, background = camera_of(model, frames, i), torch.tensor(model.background)
    with torch.no_grad():
        truth = rasterize(camera, *model.at(t), background).color.clamp(0, 1)
        color = rasterize(camera, gaussians, None, background).color.clamp(0, 1)
    return float((color - truth).square().mean())
