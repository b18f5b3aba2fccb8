"""Exports a model over time as one USD file, and measures the loss."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...pipeline import SettingsError
from ...rasterizer import Gaussians
from ...scene.camera_paths import upward
from ...scene.formats.axes import Turn
from ...scene.formats.usd.splats import stage_turn, write_usd
from ...scene.model import Model
from ..shared.posed_frameset import PosedFrameSet
from .bake import Loss, bake, loss_of, nothing_visible
from .cameras import posed_cameras

USUAL_RATE = 24.0  # time codes per second for a capture without times in seconds


@dataclass
class ExportedUsd:
    """gaussians: their number. rate: time codes per second. turn: of the scene in the stage. loss: how far the Gaussians are from the
    model."""

    gaussians: int
    rate: float
    turn: Turn
    loss: Loss


def export_usd(
    model: Model,
    frames: PosedFrameSet,
    path: Path,
    moments: Sequence[float],
    times: int,
    up: str | None = None,
    antialiased: bool = False,
    advance: Callable[[int], None] = lambda n: None,
) -> ExportedUsd:
    """Writes ``path`` (.usdc, .usda or .usd) with time samples at ``moments``, increasing, in [0, 1]; see `write_usd`.

    times: number of times of the capture; time codes are its frames, counted from 0. up: see `stage_turn`. antialiased: see `bake`.
    ``advance`` is called twice per sample. Raises SettingsError if usd-core is not installed, or for another ``up``;
    StageError if nothing is visible.
    """
    try:
        from pxr import UsdVol

        UsdVol.ParticleField3DGaussianSplat  # noqa: B018 - versions before 26.3 have no Gaussians
    except (ImportError, AttributeError) as error:
        raise SettingsError("export usd needs the package usd-core, 26.3 or later; install it with: pip install 'e4dgs[usd]'") from error
    try:
        turn = stage_turn(upward(frames.held(frames.train)), up, frames.solved)
    except ValueError as error:
        raise SettingsError(f"--up {up}: {error}; give one of these, or capture") from error
    baked = bake(model, frames, antialiased)

    def at(t: float) -> Gaussians:
        advance(1)
        return baked.at(t)

    seconds = float(np.ptp(frames.seconds))
    rate = (times - 1) / seconds if times > 1 and seconds > 0 else USUAL_RATE
    number = write_usd(path, at, moments, float(times - 1), rate, turn, posed_cameras(frames, model.near))
    if not number:
        raise nothing_visible("usd", moments)
    return ExportedUsd(number, rate, turn, loss_of(baked, frames, *moments))
