"""A model as numbered files of Gaussian splats, one for each time, and how far these are from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from ..pipeline import StageError
from ..pipeline.files import write_atomically
from .splat_bake import Loss, bake, loss_of

if TYPE_CHECKING:
    from ..scene.model import Model
    from .frameset import FrameSet

Kind = Literal["ply", "compressed-ply", "spz", "sog", "gltf"]
KINDS: dict[Kind, str] = {"ply": ".ply", "compressed-ply": ".compressed.ply", "spz": ".spz", "sog": ".sog", "gltf": ".glb"}


@dataclass
class Exported:
    """fewest, most: Gaussians of a file. loss: how far those of the first file are from the model."""

    fewest: int
    most: int
    loss: Loss


def export_splats(
    model: Model, frames: FrameSet, folder: Path, count: int, kind: Kind = "ply", advance: Callable[[int], None] = lambda n: None
) -> Exported:
    """``folder/frame0001.ply`` and so on: the Gaussians of ``model`` at ``count`` times from first to last (the middle one, if one).

    kind: of `KINDS`; all but ply lose a little. Each file is there only when it is whole. Raises StageError where ``kind`` needs a package
    that is not there.
    """
    from ..scene.gltf import glb_bytes
    from ..scene.ply import ply_bytes

    encode = _encoder(kind)

    folder.mkdir(parents=True, exist_ok=True)
    baked = bake(model, frames)
    moments = [float(t) for t in np.linspace(0, 1, count)] if count > 1 else [0.5]
    rows = []
    for k, t in enumerate(moments):
        splats = baked.at(t)
        data, number = glb_bytes(splats) if kind == "gltf" else ply_bytes(splats)
        write_atomically(folder / f"frame{k + 1:04d}{KINDS[kind]}", encode(data))
        rows.append(number)
        advance(1)
    return Exported(min(rows), max(rows), loss_of(model, baked.at(moments[0]), frames, moments[0]))


def _encoder(kind: Kind) -> Callable[[bytes], bytes]:
    """From the bytes of a PLY file, or of glTF, to those of ``kind``."""
    if kind in ("ply", "gltf"):
        return lambda data: data
    try:
        import gaussforge
    except ImportError as error:
        raise StageError(f"export {kind} needs the package gaussforge; install it with: pip install 'e4dgs[splats]'") from error
    forge, suffix = gaussforge.GaussForge(), KINDS[kind].removeprefix(".")

    def convert(data: bytes) -> bytes:
        converted = forge.convert(data, "ply", suffix)
        if "data" not in converted:
            raise StageError(f"export {kind}: {converted.get('error', 'the conversion failed')}")
        return bytes(converted["data"])

    return convert
