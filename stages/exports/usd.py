"""Exports a model over time as one USD file, and measures the loss."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...pipeline import StageError
from .bake import Loss, bake, loss_of

if TYPE_CHECKING:
    from ...rasterizer import Gaussians
    from ...scene.model import Model
    from ..artifacts.frameset import FrameSet

USUAL_RATE = 24.0  # time codes per second for a capture without times in seconds


@dataclass
class ExportedUsd:
    """gaussians: their number. rate: time codes per second. loss: how far the Gaussians are from the model."""

    gaussians: int
    rate: float
    loss: Loss


def export_usd(
    model: Model, frames: FrameSet, path: Path, count: int, times: int, advance: Callable[[int], None] = lambda n: None
) -> ExportedUsd:
    """Writes ``path`` (.usdc or .usda) with ``count`` time samples from first to last (the middle time if ``count`` is 1); see `write_usd`.

    times: number of times of the capture; time codes are its frames, counted from 0. ``advance`` is called twice per sample. Raises
    StageError if usd-core is not installed.
    """
    try:
        from pxr import UsdVol

        UsdVol.ParticleField3DGaussianSplat  # noqa: B018 - versions before 26.3 have no Gaussians
    except (ImportError, AttributeError) as error:
        raise StageError("export usd needs the package usd-core, 26.3 or later; install it with: pip install 'e4dgs[usd]'") from error
    from ...scene.camera_paths import upward
    from ...scene.formats.usd import write_usd

    assert frames.cam_from_world is not None
    baked = bake(model, frames)

    def at(t: float) -> Gaussians:
        advance(1)
        return baked.at(t)

    moments = [float(t) for t in np.linspace(0, 1, count)] if count > 1 else [0.5]
    seconds = float(np.ptp(frames.seconds))
    rate = (times - 1) / seconds if times > 1 and seconds > 0 else USUAL_RATE
    up = upward(frames.cam_from_world[frames.train])
    number = write_usd(path, at, moments, float(times - 1), rate, up)
    return ExportedUsd(number, rate, loss_of(model, baked.at(moments[0]), frames, moments[0]))
