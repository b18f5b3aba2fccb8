"""Exports a model as numbered files of Gaussian splats, one per time, and measures the loss."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from ...pipeline import StageError
from ...pipeline.files import write_atomically
from .bake import Loss, bake, loss_of
from .numbered import numbered, remove_later

if TYPE_CHECKING:
    from ...rasterizer import Gaussians
    from ...scene.model import Model
    from ..artifacts.frameset import FrameSet

Kind = Literal["ply", "compressed-ply", "spz", "sog", "gltf"]
KINDS: dict[Kind, str] = {"ply": ".ply", "compressed-ply": ".compressed.ply", "spz": ".spz", "sog": ".sog", "gltf": ".glb"}


@dataclass
class Exported:
    """fewest, most: number of Gaussians per file. loss: how far the first file is from the model."""

    fewest: int
    most: int
    loss: Loss


def export_splats(
    model: Model, frames: FrameSet, folder: Path, count: int, kind: Kind = "ply", advance: Callable[[int], None] = lambda n: None
) -> Exported:
    """Writes ``folder/frame0001.ply`` and so on: the Gaussians of ``model`` at ``count`` times from first to last (the middle time if
    ``count`` is 1).

    kind: one of `KINDS`; all but ply are slightly lossy. Files are written atomically; those that an earlier export of more times has left
    are removed at the end. Raises StageError if ``kind`` needs a package that is not installed, OSError if the folder cannot be written.
    """
    encode = encoder(kind)

    folder.mkdir(parents=True, exist_ok=True)
    baked = bake(model, frames)
    moments = [float(t) for t in np.linspace(0, 1, count)] if count > 1 else [0.5]
    rows = []
    for k, t in enumerate(moments):
        file = numbered(folder, k, KINDS[kind])
        try:
            data, number = encode(baked.at(t))
        except ValueError as error:
            raise StageError(f"export {kind}: {file}: {error}; export ply instead") from error
        write_atomically(file, data)
        rows.append(number)
        advance(1)
    remove_later(folder, count, KINDS[kind])
    return Exported(min(rows), max(rows), loss_of(model, baked.at(moments[0]), frames, moments[0]))


def encoder(kind: Kind) -> Callable[[Gaussians], tuple[bytes, int]]:
    """A function from Gaussians to the bytes of a file of ``kind`` and the number of Gaussians in it."""
    from ...scene.formats.compressed_ply import compressed_ply_bytes
    from ...scene.formats.gltf import glb_bytes
    from ...scene.formats.ply import ply_bytes
    from ...scene.formats.spz import spz_bytes

    writers: dict[Kind, Callable[[Gaussians], tuple[bytes, int]]] = {
        "ply": ply_bytes,
        "compressed-ply": compressed_ply_bytes,
        "spz": spz_bytes,
        "gltf": glb_bytes,
    }
    return writers[kind] if kind in writers else _sog_encoder()


def _sog_encoder() -> Callable[[Gaussians], tuple[bytes, int]]:
    try:
        import gaussforge
    except ImportError as error:
        raise StageError("export sog needs the package gaussforge; install it with: pip install 'e4dgs[splats]'") from error

    from ...scene.formats.ply import ply_bytes

    forge = gaussforge.GaussForge()

    def encode(gaussians: Gaussians) -> tuple[bytes, int]:
        plain, number = ply_bytes(gaussians)
        converted = forge.convert(plain, "ply", "sog")
        if "data" not in converted:
            raise StageError(f"export sog: {converted.get('error', 'the conversion failed')}")
        return bytes(converted["data"]), number

    return encode
