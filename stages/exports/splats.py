"""Exports a model as files of Gaussian splats, one per time, and measures the loss."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from PIL import features

from ...pipeline import SettingsError, StageError
from ...pipeline.files import write_atomically
from ...rasterizer import Gaussians
from ...scene.camera_paths import upward
from ...scene.formats.axes import Turn, nearest_axis
from ...scene.formats.compressed_ply import compressed_ply_bytes
from ...scene.formats.gltf import glb_bytes
from ...scene.formats.ply import ply_bytes
from ...scene.formats.sog import sog_bytes
from ...scene.formats.spz import cut_by_spz, spz_bytes
from ...scene.model import Model
from ..shared.posed_frameset import PosedFrameSet
from .bake import Loss, bake, loss_of, nothing_visible
from .numbered import KINDS, SplatFormat, new_sequence, numbered, write_index

# SPZ's axes are right, up, back; glTF says +Y is up. The others are written right, down, front by 3DGS and whoever followed it.
UP: dict[SplatFormat, str] = {"ply": "-Y", "compressed-ply": "-Y", "spz": "Y", "sog": "-Y", "gltf": "Y"}


@dataclass
class Exported:
    """fewest, most: number of Gaussians per file. turn: from the capture's axes to those of the files. loss: how far the files that show
    something are from the model, before rounding. notes: what the format cuts in the first of these, and which files are empty, a line
    each."""

    fewest: int
    most: int
    turn: Turn
    loss: Loss
    notes: list[str]


def export_splats(
    model: Model,
    frames: PosedFrameSet,
    out: Path,
    moments: Sequence[float],
    kind: SplatFormat = "ply",
    single: bool = False,
    up: str | None = None,
    antialiased: bool = False,
    advance: Callable[[int], None] = lambda n: None,
) -> Exported:
    """Writes the Gaussians of ``model`` at ``moments`` in [0, 1] to ``out``/frame0001.ply and so on, or if ``single`` to the file ``out``.

    kind: one of `KINDS`; all but ply and gltf are slightly lossy. up: the axis of the file that points up in the scene, `UP` by default, or
    "capture" for the capture's own axes. antialiased: write the Gaussians of an antialiased model as they are; see `bake`. Nothing is left
    of an export that does not come to its end, and an earlier sequence is replaced as a whole. Raises as `bake`
    does; StageError if nothing is visible or ``kind`` cannot hold a position; OSError if a file cannot be written."""
    if single and len(moments) != 1:
        raise ValueError(f"one file holds one time, not {len(moments)}")
    turn = turn_of(frames, up, UP[kind])
    encode = encoder(kind, turn, antialiased)
    baked = bake(model, frames, antialiased)
    rows = []

    def write(file: Path, t: float) -> None:
        try:
            data, number = encode(baked.at(t))
        except ValueError as error:
            raise StageError(f"export {kind}: {file.name}: {error}; export ply instead") from error
        rows.append(number)
        if len(rows) == len(moments) and not any(rows):
            raise nothing_visible(kind, moments)
        write_atomically(file, data)
        advance(1)

    if single:
        write(out, moments[0])
    else:
        with new_sequence(out, KINDS[kind]) as folder:
            for k, t in enumerate(moments):
                write(numbered(folder, k, KINDS[kind]), t)
            about = {"format": kind, "up": turn.after, "antialiased": antialiased, **origin_of(frames)}
            write_index(folder, KINDS[kind], moments, float(np.ptp(frames.seconds)), about)
    empty, shown = [k for k, number in enumerate(rows) if not number], [t for t, number in zip(moments, rows) if number]
    notes = cut_by_spz(baked.at(shown[0])) if kind == "spz" else []
    if empty:
        where = f"time {moments[empty[0]]:g} ({numbered(out, empty[0], KINDS[kind]).name})"
        notes.append(f"nothing is visible at {len(empty)} of {len(rows)} times, first at {where}; there the files show nothing")
    return Exported(min(rows), max(rows), turn, loss_of(baked, frames, *shown), notes)


def origin_of(frames: PosedFrameSet) -> dict[str, list[float]]:
    """What an index says of a capture that was moved: the point of its files' world that is 0 0 0 here; nothing of any other."""
    return {} if frames.origin is None else {"origin": [float(x) for x in frames.origin]}


def turn_of(frames: PosedFrameSet, up: str | None, usual: str) -> Turn:
    """From the axes of the capture, whose up direction is the mean one of its training cameras, to those of a file with ``up`` (`AXES`, or
    "capture" for none) or else ``usual`` pointing up. Axes that the capture's files give stand upright, so the nearest one is up. Those of
    our own structure from motion are one camera's, however it was held, so there the direction itself is brought upright."""
    direction = upward(frames.held(frames.train))
    axis = nearest_axis(direction)
    if up == "capture":
        return Turn(axis, axis)
    return Turn.levelling(direction, up or usual) if frames.solved else Turn(axis, up or usual)


def comments_of(turn: Turn | None, antialiased: bool) -> list[str]:
    """Lines of the header of a .ply file. Brush and splat-transform (3.2 and later) read the first, and write it."""
    return [f"SplatRenderMode: {'mip' if antialiased else 'default'}", *([] if turn is None else [f"up: {turn.after}"])]


def encoder(kind: SplatFormat, turn: Turn | None = None, antialiased: bool = False) -> Callable[[Gaussians], tuple[bytes, int]]:
    """A function from Gaussians to the bytes of a file of ``kind`` and the number of Gaussians in it.

    turn: from their axes to those of the file; none is turned without it. In a .glb file the node turns, and the Gaussians stay as they
    are. antialiased: say in the file, where the format can, that they are meant for renderers that compensate opacity.
    Raises SettingsError if Pillow cannot write the images of a .sog file."""
    if kind == "sog" and not features.check("webp"):
        raise SettingsError(
            "export sog needs Pillow with WebP, which its wheels have: pip install --force-reinstall --only-binary :all: pillow"
        )
    if kind == "gltf":
        return partial(glb_bytes, turn=turn)
    comments = comments_of(turn, antialiased)
    writers: dict[SplatFormat, Callable[[Gaussians], tuple[bytes, int]]] = {
        "ply": partial(ply_bytes, comments=comments),
        "compressed-ply": partial(compressed_ply_bytes, comments=comments),
        "spz": partial(spz_bytes, antialiased=antialiased),
        "sog": partial(sog_bytes, antialiased=antialiased),
    }
    write = writers[kind]
    return lambda gaussians: write(gaussians if turn is None else turn(gaussians))
