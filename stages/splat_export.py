"""A model as numbered files of Gaussian splats, one for each time, and how far these are from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from ..pipeline import StageError
from ..pipeline.files import write_atomically

if TYPE_CHECKING:
    from ..rasterizer import Gaussians
    from ..scene.model import Model
    from .frameset import FrameSet

Kind = Literal["ply", "compressed-ply", "spz", "sog", "gltf"]
KINDS: dict[Kind, str] = {"ply": ".ply", "compressed-ply": ".compressed.ply", "spz": ".spz", "sog": ".sog", "gltf": ".glb"}
SPREADS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0)  # of a convex's points: standard deviations of the Gaussian for it, of which the best is taken
LOOKS = 4  # views that judge


@dataclass
class Exported:
    """fewest, most: Gaussians of a file. convexes: how many became Gaussians. psnr: dB between renders with these and with the convexes."""

    fewest: int
    most: int
    convexes: int
    psnr: float | None


def export_splats(
    model: Model, frames: FrameSet, folder: Path, count: int, kind: Kind = "ply", advance: Callable[[int], None] = lambda n: None
) -> Exported:
    """``folder/frame0001.ply`` and so on: the Gaussians of ``model`` at ``count`` times from first to last (the middle one, if one).

    kind: of `KINDS`; all but ply lose a little. Each file is there only when it is whole. Raises StageError where ``kind`` needs a package
    that is not there.
    """
    import torch

    from ..scene.gltf import glb_bytes
    from ..scene.ply import as_gaussians, joined, ply_bytes

    encode = _encoder(kind)

    folder.mkdir(parents=True, exist_ok=True)
    spread, psnr = best_spread(model, frames) if len(model.convexes) else (1.0, None)
    rows = []
    for k, t in enumerate(np.linspace(0, 1, count) if count > 1 else [0.5]):
        with torch.no_grad():
            gaussians, convexes = model.at(float(t))
            splats = joined(gaussians, as_gaussians(convexes, spread))
            data, number = glb_bytes(splats) if kind == "gltf" else ply_bytes(splats)
            write_atomically(folder / f"frame{k + 1:04d}{KINDS[kind]}", encode(data))
            rows.append(number)
        advance(1)
    return Exported(min(rows), max(rows), len(model.convexes), psnr)


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
