"""What other programs read in exported files, beside the model that was exported.

    python benchmarks/exports.py WORKSPACE [--name SCENE] [--times 3] [--size 400] [--keep DIR] [--out FILE.json]

Exports a finished run of WORKSPACE at three times in every format, reads each file with a program that did not write it (export_readers.py
says which, and how to install them), and compares all Gaussians and their renders from cameras of the capture, of at most --size px, on the
model's background. Convexes are baked to Gaussians once; how far that is from the full model is its own row. A reader that is not installed
is said, and its rows are left out. Ends with 1 where a format misses its bar.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import export_readers as readers
import numpy as np
import torch
from e4dgs.pipeline import Records, StageError, Store
from e4dgs.rasterizer import Camera, Gaussians
from e4dgs.scene.formats.axes import Turn
from e4dgs.scene.formats.ply import seen
from e4dgs.scene.formats.usd.splats import write_usd
from e4dgs.scene.mesh import Mesh, mesh_glb_bytes, mesh_ply_bytes
from e4dgs.scene.model import Model
from e4dgs.stages.exports.bake import bake, loss_of
from e4dgs.stages.exports.capture_cameras import camera_of, distinct_views
from e4dgs.stages.exports.mesh import fuse, hulls, size_of
from e4dgs.stages.exports.splats import KINDS, encoder
from e4dgs.stages.shared.posed_frameset import PosedFrameSet
from e4dgs.workflows.bench.machine import machine
from e4dgs.workflows.load import load
from export_errors import errors, psnr

LOOKS = 4  # cameras
BARS = {"ply": 1e-4, "gltf": 1e-4, "usd": 1e-4, "spz": 2e-4, "sog": 2e-4, "compressed-ply": 3e-3}  # positions, of the scene's size
LEAST_PSNR = {"ply": 45.0, "gltf": 45.0, "usd": 45.0}  # the others round colours and SH, each in its own way


@dataclass
class Scene:
    """A finished run: its model, its frames, and cameras that look at it, of at most the size that was asked for."""

    name: str
    model: Model
    frames: PosedFrameSet
    cameras: list[Camera]


def open_scene(workspace: Path, name: str | None, size: int) -> Scene:
    every = sorted(claim.parent for claim in (workspace / "scenes").glob("*/capture.json"))
    scenes = [folder for folder in every if name in (None, folder.name)]
    if len(scenes) != 1:
        raise SystemExit(
            f"{workspace}: {len(scenes)} scenes fit; give --name one of: {', '.join(s.name for s in every) or 'none is there'}"
        )
    model = load(scenes[0], device="cpu")
    records, store = Records(scenes[0] / "records"), Store(workspace / "store")
    found = {stage: store.open(stage, record["key"]) for stage in ("frames", "poses") if (record := records.read(stage)) is not None}
    frames = PosedFrameSet(found["frames"], Path(json.loads((scenes[0] / "capture.json").read_text())["path"]), found.get("poses"))
    some = distinct_views(frames, np.concatenate([frames.test, frames.val, frames.train]), LOOKS)
    return Scene(scenes[0].name, model, frames, [smaller(camera_of(model, frames, int(i)), size) for i in some])


def smaller(camera: Camera, size: int) -> Camera:
    factor = min(1.0, size / max(camera.width, camera.height))
    width, height = round(camera.width * factor), round(camera.height * factor)
    return replace(camera, K=camera.K * torch.tensor([[width / camera.width], [height / camera.height], [1.0]]), width=width, height=height)


def splat_rows(scene: Scene, moments: list[float], folder: Path) -> Iterator[dict[str, Any]]:
    """A row for each format, reader and time, and first one of what baking costs."""
    baked = bake(scene.model, scene.frames)
    loss = loss_of(baked, scene.frames, moments[0])
    yield {"format": "baked", "reader": "none", "time": moments[0], "psnr": loss.psnr, "convexes": loss.convexes}
    transform, modules = readers.splat_transform(), readers.node_modules()
    for kind, suffix in KINDS.items():
        encode = encoder(kind)
        for k, t in enumerate(moments):
            written, file = baked.at(t), folder / f"frame{k + 1:04d}{suffix}"
            file.write_bytes(encode(written)[0])
            row = {"format": kind, "time": t, "bytes": file.stat().st_size}
            if kind == "gltf" and modules is not None:
                read = readers.by_three(modules, file)
                row |= {"reader": f"three {read['three']}", "validator": readers.errors_of_standard_parts(read)}
                yield row | compared(scene, written, readers.gaussians_of_three(read))
            if kind != "gltf" and transform is not None:
                row |= {"reader": f"splat-transform {readers.version_of(transform)}"}
                yield row | compared(scene, written, readers.by_splat_transform(transform, file))
            if kind == "ply" and (version := readers.installed("plyfile")):
                yield row | {"reader": f"plyfile {version}"} | compared(scene, written, readers.by_plyfile(file))
    if version := readers.installed("usd-core"):
        file = folder / "scene.usdc"
        write_usd(file, baked.at, moments, 1.0, 24.0, Turn("Z", "Z"))
        for t in moments:
            row = {"format": "usd", "reader": f"usd-core {version}", "time": t, "bytes": file.stat().st_size}
            yield row | compared(scene, baked.at(t), seen(readers.by_usd(file, t)))


def compared(scene: Scene, written: Gaussians, read: Gaussians) -> dict[str, Any]:
    return errors(written, read) | {"psnr": psnr(written, read, scene.cameras, scene.model.background)}


def mesh_rows(scene: Scene, moments: list[float], folder: Path) -> Iterator[dict[str, Any]]:
    """Meshes of several times as one .glb file that plays, and as .ply: the fused scene, and the hulls of its convexes."""
    modules, version = readers.node_modules(), readers.installed("trimesh")
    made = {}
    try:
        size = size_of(scene.model, scene.frames, moments[0])
        made["mesh"] = [fuse(scene.model, scene.frames, t, size) for t in moments]
    except StageError as error:  # nothing solid, or no Open3D
        print(f"no mesh: {error}")
    if len(scene.model.convexes):
        made["convexes"] = [hulls(scene.model, t) for t in moments]
    for name, meshes in made.items():
        file = folder / f"{name}.glb"
        file.write_bytes(mesh_glb_bytes(meshes, [float(k) for k in range(len(meshes))]))
        row = {"format": f"{name} glb", "bytes": file.stat().st_size}
        if modules is not None:
            read = readers.by_three(modules, file)
            shown = [(mesh["attributes"]["position"], mesh["indices"].reshape(-1, 3)) for mesh in read["meshes"]]
            row |= {"reader": f"three {read['three']}", "validator": readers.errors_of_standard_parts(read)}
            yield row | {"tracks": sum(len(one["tracks"]) for one in read["animations"])} | unlike(meshes, shown)
        if version:
            import trimesh

            files = [folder / f"{name}{k:04d}.ply" for k in range(1, len(meshes) + 1)]
            for one, path in zip(meshes, files):
                path.write_bytes(mesh_ply_bytes(one))
            back = [trimesh.load(path, process=False) for path in files]
            row = {"format": f"{name} ply", "reader": f"trimesh {version}", "bytes": files[0].stat().st_size}
            yield row | unlike(meshes, [(one.vertices, one.faces) for one in back])


def unlike(meshes: list[Mesh], shown: list[tuple[np.ndarray, np.ndarray]]) -> dict[str, Any]:
    """lost: triangles and vertices too many, too few or with other corners. position: the largest error of a vertex, world units."""
    lost, position, size = abs(len(meshes) - len(shown)), 0.0, 1e-30
    for mesh, (vertices, triangles) in zip(meshes, shown):
        if vertices.shape != mesh.vertices.shape or triangles.shape != mesh.triangles.shape:
            lost += abs(len(vertices) - len(mesh.vertices)) + abs(len(triangles) - len(mesh.triangles))
            continue
        lost += int((triangles != mesh.triangles).any(1).sum())
        position = max(position, float(np.abs(vertices - mesh.vertices).max(initial=0.0)))
        size = max(size, float(np.ptp(mesh.vertices, axis=0).max()) if len(vertices) else 0.0)
    return {"lost": lost, "position": position, "relative": position / size}


def misses(row: dict[str, Any]) -> list[str]:
    """What of ``row`` is worse than its bar."""
    found = [f"{row['lost']} lost"] if row.get("lost") else []
    found += [f"{len(row['validator'])} errors of the validator"] if row.get("validator") else []
    found += ["positions"] if row.get("relative", 0.0) > BARS.get(row["format"], 1e-4) else []
    return found + (["PSNR"] if row.get("psnr", 100.0) < LEAST_PSNR.get(row["format"], 0.0) else [])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("workspace", type=Path)
    parser.add_argument("--name")
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--size", type=int, default=400)
    parser.add_argument("--keep", type=Path, help="folder for the exported files, which are removed otherwise")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    scene = open_scene(arguments.workspace, arguments.name, arguments.size)
    moments = [float(t) for t in np.linspace(0, 1, arguments.times)] if not scene.model.motion.static else [0.5]
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for made in (splat_rows, mesh_rows):
            for row in made(scene, moments, folder):
                row["misses"] = misses(row)
                rows.append(row)
                print(line(row), flush=True)
    for missing in readers.missing():
        print(f"not read: {missing}")
    result = {"scene": scene.name, "rows": rows, "bars": BARS, "psnr_bars": LEAST_PSNR, "not_read": readers.missing(), "machine": machine()}
    if arguments.out:
        arguments.out.write_text(json.dumps(result, indent=1) + "\n")
    return int(any(row["misses"] for row in rows))


def line(row: dict[str, Any]) -> str:
    words = [f"{row['format']:15}", f"{row['reader']:22}", f"t {row['time']:.2f}" if "time" in row else " " * 6]
    words += [f"{row['bytes'] / 1e3:9.1f} kB"] if "bytes" in row else []
    words += [f"positions {row['position']:.1e} ({row['relative']:.1e} of the scene)"] if "position" in row else []
    words += [f"scales {row['scale']:.1e} rotations {row['rotation']:.1e} deg opacity {row['opacity']:.1e}"] if "scale" in row else []
    words += [f"color {row['color']:.1e} sh {row['sh']:.1e}"] if "color" in row else []
    words += [f"{row['psnr']:.1f} dB"] if "psnr" in row else []
    return "  ".join(words + ([f"MISSES: {', '.join(row['misses'])}"] if row["misses"] else []))


if __name__ == "__main__":
    sys.exit(main())
