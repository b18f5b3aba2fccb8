"""Exports a model over time as one file of Gaussians on straight paths (`.4dgs`, PLY of FreeTimeGS), and measures the loss."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from ....pipeline import SettingsError, counted
from ....pipeline.files import write_atomically
from ....rasterizer import Gaussians, rasterize
from ....scene.formats.axes import Turn
from ....scene.formats.freetime import freetime_bytes, read_freetime
from ....scene.formats.gaussian_birth import Clock, View, container_bytes, read_container
from ....scene.formats.pieces import Pieces
from ....scene.metrics.psnr import decibels
from ....scene.model import Model
from ...shared.posed_frameset import PosedFrameSet
from ..bake import Baked, Loss, bake, loss_of, nothing_visible
from ..camera_path import looked_at
from ..capture_cameras import camera_of, distinct_views
from ..plain import compensated
from ..splats import comments_of, turn_of
from ..web import pixel_width
from .colors import fitting_colors
from .pieces import halvings, pieces_of, still_pieces, turned_pieces
from .soft import soft_pieces

Straight = Literal["4dgs", "freetime"]
UP: dict[Straight, str] = {"4dgs": "Y", "freetime": "-Y"}
USUAL_RATE = 24.0  # times per second for a capture without seconds
EYES = 64  # cameras from which colours are held to the model's
MOMENTS = 0.0, 0.25, 0.5, 0.75, 1.0  # at which the file is compared with the model


@dataclass
class ExportedStraight:
    """gaussians: of the model; pieces: in the file. psnr: dB, what is decoded from the file against the model with Gaussians in place of
    its convexes, over `MOMENTS` of the clip. loss: what these Gaussians lose against the whole model. size: bytes. seconds: of the clip, 0
    of a still. shortest: seconds of a piece below which none is cut, for want of memory; 0 without that limit."""

    gaussians: int
    pieces: int
    psnr: float
    loss: Loss
    turn: Turn
    size: int
    seconds: float
    shortest: float

    def __str__(self) -> str:
        size = f"{self.size / 1e6:.2f} MB" + (f", {self.size / 1e6 / self.seconds:.2f} MB a second" if self.seconds else "")
        decoded = f"{self.psnr:.1f} dB from the model's Gaussians when decoded" + (f", over {len(MOMENTS)} times" if self.seconds else "")
        pieces = counted(self.pieces, "straight piece")
        pieces += f", none shorter than {self.shortest:.2g} s, which is all that memory allows" if self.shortest else ""
        return f"{counted(self.gaussians, 'Gaussian')} in {pieces}; {size}; {decoded}; {self.loss}"


def export_straight(
    model: Model,
    frames: PosedFrameSet,
    out: Path,
    times: int,
    kind: Straight = "4dgs",
    moment: float | None = None,
    up: str | None = None,
    antialiased: bool = False,
    advance: Callable[[int], None] = lambda n: None,
) -> ExportedStraight:
    """Writes ``out``. times: of the capture. moment: only this time in [0, 1], as a still. up, antialiased: see `export_splats`.
    ``advance`` is called after each of four parts. Raises SettingsError if a package is missing, StageError if nothing is
    visible, and as `bake` does."""
    if kind == "4dgs":
        try:
            import fourdgs  # noqa: F401 - checked before the work begins
        except ImportError as error:
            raise SettingsError("export 4dgs needs the package fourdgs; install it with: pip install 'e4dgs[fourdgs]'") from error
    moves = times > 1 and moment is None
    looked = MOMENTS if moves else (moment or 0.0,)
    turn, target = turn_of(frames, up, UP[kind]), np.asarray(looked_at(frames, model))
    baked = bake(model, frames, antialiased)
    advance(1)
    if moves:
        pieces = (pieces_of if kind == "4dgs" else soft_pieces)(baked, times, pixel_width(frames, target))
    else:
        pieces = still_pieces(baked, looked[0])
    if not len(pieces):
        raise nothing_visible("4dgs" if kind == "4dgs" else "ply --freetime", range(times) if moves else looked)
    if kind == "4dgs":
        pieces = fitting_colors(pieces, eyes_of(frames))
    advance(1)
    clock = clock_of(frames, times if moves else 1)
    data = written(turned_pieces(pieces, turn), frames, clock, Look(kind, target, turn, antialiased, out.stem, times if moves else 1))
    write_atomically(out, data)
    advance(1)
    psnr = compared(baked, frames, decoder(kind, data, clock, turn), looked)
    advance(1)
    count = len(model.gaussians) + len(model.convexes)
    loss = loss_of(baked, frames, *looked)
    levels, wanted = halvings(baked, times) if moves else (0, 0)
    shortest = clock.span / (1 << levels) if levels < wanted else 0.0
    return ExportedStraight(count, len(pieces), psnr, loss, turn, len(data), clock.seconds if moves else 0.0, shortest)


@dataclass
class Look:
    """What a file says of its scene. target [3]: the point to look at, in the axes of the capture. times: of the clip."""

    kind: Straight
    target: np.ndarray
    turn: Turn
    antialiased: bool
    title: str
    times: int


def written(pieces: Pieces, frames: PosedFrameSet, clock: Clock, look: Look) -> bytes:
    """The file with ``pieces``, which are in its axes."""
    if look.kind == "4dgs":
        return container_bytes(pieces, clock, look.turn, view_of(frames, look.target, look.turn), look.title)
    return freetime_bytes(pieces, look.times, comments_of(look.turn, look.antialiased))


def decoder(kind: Straight, data: bytes, clock: Clock, turn: Turn) -> Callable[[float], Gaussians]:
    """What a reader makes of the file at a time in [0, 1], in the axes of the capture."""
    if kind == "freetime":
        pieces = read_freetime(data)
        return lambda t: turn.back(pieces.at(t))
    at = read_container(data)
    return lambda t: turn.back(at(t * clock.span))


def clock_of(frames: PosedFrameSet, times: int) -> Clock:
    """Every time of the capture lasts equally long, the last one, too."""
    span = float(np.ptp(frames.seconds)) or max(times - 1, 1) / USUAL_RATE
    return Clock(span, span * times / (times - 1)) if times > 1 else Clock(1.0, 1.0)


def view_of(frames: PosedFrameSet, target: np.ndarray, turn: Turn) -> View:
    """The first camera of the capture, in the axes of a file."""
    first = int(frames.train[0]) if len(frames.train) else 0
    pose, K = frames.cam_from_world[first], frames.K[first]
    angle = 2 * math.degrees(math.atan(frames.height / (2 * K[1, 1])))
    place = -pose[:3, :3].T @ pose[:3, 3]
    return View(angle, turn.matrix @ place, turn.matrix @ target)


def eyes_of(frames: PosedFrameSet) -> Tensor:
    """[V, 3] places of at most `EYES` cameras of the capture."""
    poses = torch.as_tensor(frames.cam_from_world[distinct_views(frames, frames.train, EYES)]).double()
    return -(poses[:, :3, :3].transpose(1, 2) @ poses[:, :3, 3:])[..., 0]


def compared(baked: Baked, frames: PosedFrameSet, decoded: Callable[[float], Gaussians], moments: tuple[float, ...]) -> float:
    """PSNR, dB, of renders of ``decoded`` against renders of ``baked`` in the mode that these are for, each moment from another camera."""
    chosen = distinct_views(frames, np.concatenate([frames.test, frames.val, frames.train]), len(moments))
    background, error = torch.tensor(baked.model.background), []
    for k, t in enumerate(moments):
        camera, pair = camera_of(baked.model, frames, int(chosen[k % len(chosen)])), []
        for gaussians in (baked.at(t), decoded(t)):
            shown = compensated(camera, gaussians) if baked.antialiased else gaussians
            with torch.no_grad():
                pair.append(rasterize(camera, shown, None, background).color.clamp(0, 1))
        error.append(float((pair[0] - pair[1]).square().mean()))
    return decibels(float(np.mean(error)))
