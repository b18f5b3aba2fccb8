"""Exported files as other programs read them: splat-transform (PlayCanvas), plyfile, three.js with the Khronos validator, usd-core.

The programs from npm are looked for in the folder that the variable E4DGS_NPM names (below its node_modules), then by `npx --no-install`:

    npm install --legacy-peer-deps @playcanvas/splat-transform gltf-validator three
"""

from __future__ import annotations

import functools
import json
import os
import shutil
import subprocess
import tempfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from e4dgs.rasterizer import Gaussians

TRANSFORM = "splat-transform"
SPLATS = "khr_gaussian_splatting:"  # three.js writes names of attributes in small letters
UNKNOWN = "KHR_gaussian_splatting:"  # the validator knows this extension not yet, and takes its attributes' names for wrong ones


@functools.cache
def splat_transform() -> tuple[str, ...] | None:
    """The command, or None where it is not installed."""
    folder = os.environ.get("E4DGS_NPM")
    if folder is not None:
        program = Path(folder) / "node_modules" / ".bin" / TRANSFORM
        return (str(program),) if program.exists() else None
    npx = shutil.which("npx")
    if npx is None or subprocess.run([npx, "--no-install", TRANSFORM, "--version"], capture_output=True).returncode != 0:
        return None
    return npx, "--no-install", TRANSFORM


def node_modules() -> Path | None:
    """The folder with three and gltf-validator, or None."""
    folder = Path(os.environ.get("E4DGS_NPM", ".")) / "node_modules"
    there = all((folder / name).is_dir() for name in ("three", "gltf-validator")) and shutil.which("node") is not None
    return folder.resolve() if there else None


def installed(package: str) -> str | None:
    """The version of a Python package, or None where it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def missing() -> list[str]:
    """Which readers are not installed."""
    found = [] if splat_transform() is not None else ["splat-transform (npm: @playcanvas/splat-transform)"]
    found += [] if node_modules() is not None else ["three and gltf-validator (npm), or node"]
    return found + [f"{name} (PyPI)" for name in ("plyfile", "usd-core", "trimesh") if installed(name) is None]


@functools.cache
def version_of(command: tuple[str, ...]) -> str:
    done = subprocess.run([*command, "--version"], capture_output=True, text=True, check=True)
    words = (done.stdout + done.stderr).split()
    return words[words.index(TRANSFORM) + 1].removeprefix("v")


def by_splat_transform(command: tuple[str, ...], file: Path) -> Gaussians:
    """``file`` (.ply, .compressed.ply, .spz, .sog) by way of the table of numbers that splat-transform makes of it."""
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "read.csv"
        done = subprocess.run([*command, "--quiet", str(file), str(table)], capture_output=True, text=True)
        if done.returncode != 0:
            raise RuntimeError(f"{TRANSFORM} cannot read {file}: {(done.stderr or done.stdout).strip()}")
        with table.open() as opened:
            names = opened.readline().strip().split(",")
            rows = np.loadtxt(opened, delimiter=",", ndmin=2, dtype=np.float64)
    return from_columns({name: rows[:, k] for k, name in enumerate(names)})


def by_plyfile(file: Path) -> Gaussians:
    from plyfile import PlyData

    vertex = PlyData.read(str(file))["vertex"]
    return from_columns({name: np.asarray(vertex[name], np.float64) for name in vertex.data.dtype.names})


def from_columns(column: dict[str, np.ndarray]) -> Gaussians:
    """By the definition of the layout: SH of a channel lie together, scales are logarithms, opacity is a logit, rotations are w x y z."""

    def of(prefix: str, count: int) -> np.ndarray:
        return np.stack([column[f"{prefix}_{k}"] for k in range(count)], 1)

    means = np.stack([column[name] for name in "xyz"], 1)
    rest = sum(name.startswith("f_rest_") for name in column)
    sh = of("f_dc", 3)[:, None]
    if rest:
        sh = np.concatenate([sh, of("f_rest", rest).reshape(len(means), 3, -1).transpose(0, 2, 1)], 1)
    with np.errstate(over="ignore"):
        opacities = 1 / (1 + np.exp(-column["opacity"]))
    return _gaussians(means, of("rot", 4), np.exp(of("scale", 3)), opacities, sh)


def by_three(modules: Path, file: Path) -> dict[str, Any]:
    """What `read_gltf.mjs` tells of ``file``, with arrays [n, width] in place of where they lie."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "read"
        script = Path(__file__).with_name("read_gltf.mjs")
        done = subprocess.run(["node", str(script), str(modules), str(file), str(out)], capture_output=True, text=True)
        if done.returncode != 0:
            raise RuntimeError(f"three.js cannot read {file}: {done.stderr.strip()}")
        numbers = np.fromfile(out.with_suffix(".bin"), np.float64)

        def array(place: dict[str, Any]) -> Any:
            if place.keys() != {"start", "length", "width"}:
                return place
            return numbers[place["start"] : place["start"] + place["length"]].reshape(-1, place["width"])

        return json.loads(out.with_suffix(".json").read_text(), object_hook=array)


def gaussians_of_three(read: dict[str, Any]) -> Gaussians:
    """By the definition of KHR_gaussian_splatting: linear scales, opacity in [0, 1], rotations x y z w."""
    (mesh,) = read["meshes"]
    found = mesh["attributes"]
    coefficients = sum(name.startswith(f"{SPLATS}sh_degree_") for name in found)
    degrees = range(round(coefficients**0.5))
    sh = np.stack([found[f"{SPLATS}sh_degree_{d}_coef_{n}"] for d in degrees for n in range(2 * d + 1)], 1)
    quats = found[f"{SPLATS}rotation"][:, [3, 0, 1, 2]]
    return _gaussians(found["position"], quats, found[f"{SPLATS}scale"], found[f"{SPLATS}opacity"][:, 0], sh)


def errors_of_standard_parts(read: dict[str, Any]) -> list[str]:
    """The validator's errors and warnings, without those on names of attributes of KHR_gaussian_splatting, which it does not know."""
    found = [one for one in read["issues"]["messages"] if one["severity"] <= 1]
    ours = [one for one in found if not (one["code"] == "MESH_PRIMITIVE_INVALID_ATTRIBUTE" and f"/{UNKNOWN}" in one["pointer"])]
    return [f"{one['code']} {one.get('pointer', '')}: {one['message']}" for one in ours]


def by_usd(file: Path, code: float) -> Gaussians:
    from pxr import Usd, UsdVol

    stage = Usd.Stage.Open(str(file))
    (prim,) = (one for one in stage.Traverse() if one.IsA(UsdVol.ParticleField3DGaussianSplat))
    splats = UsdVol.ParticleField3DGaussianSplat(prim)
    means, scales, opacities = (
        np.array(a.Get(code)) for a in (splats.GetPositionsAttr(), splats.GetScalesAttr(), splats.GetOpacitiesAttr())
    )
    quats = np.array([[q.real, *q.imaginary] for q in splats.GetOrientationsAttr().Get(code)])
    degree = splats.GetRadianceSphericalHarmonicsDegreeAttr().Get()
    sh = np.array(splats.GetRadianceSphericalHarmonicsCoefficientsAttr().Get(code)).reshape(len(means), (degree + 1) ** 2, 3)
    return _gaussians(means, quats, scales, opacities, sh)


def _gaussians(*arrays: np.ndarray) -> Gaussians:
    """Of means, quats, scales, opacities, sh."""
    means, quats, scales, opacities, sh = (torch.tensor(np.ascontiguousarray(a)).float() for a in arrays)
    return Gaussians(means, quats, scales, opacities, sh=sh)
