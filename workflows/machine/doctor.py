"""`e4dgs doctor`: what this installation has and what is missing. Every check catches its own failure."""

from __future__ import annotations

import os
import platform
import re
import shutil
import sys
from collections.abc import Callable
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

from .devices import why_not_cuda, why_not_trusted

_MIN_FREE_GB = 5.0


def checks(workspace: Path) -> list[tuple[str, bool | None, str]]:
    """(what, well, detail); ``well`` is None for a fact that is neither good nor bad."""
    found: list[tuple[str, bool | None, str]] = [
        ("python", sys.version_info >= (3, 11), f"{platform.python_version()} on {platform.system()} {platform.machine()}"),
        ("e4dgs", True, _installed_version()),
    ]
    found += _libraries()
    found.append(("CPU kernels", *_try(_render)))
    found.append(("threads", *_try(_threads)))
    found.append(("pycolmap loads", *_try(_pycolmap)))
    loads, detail = _try(_open3d)
    found.append(("Open3D loads", loads or None, detail if loads else f"only meshes and scanned point clouds need it: {detail}"))
    found.append(("zarr writes and reads", *_try(_zarr)))
    found.append(("LPIPS", *_lpips()))
    problem = why_not_cuda() or why_not_trusted()
    found.append(("CUDA", True if problem is None else None, f"--device auto takes the CPU: {problem}" if problem else "usable"))
    found += _cuda()
    free = shutil.disk_usage(_existing(workspace)).free / 1e9
    writable = os.access(_existing(workspace), os.W_OK)
    found.append(("workspace", free >= _MIN_FREE_GB and writable, f"{workspace}: {free:.0f} GB free{'' if writable else ', NOT writable'}"))
    found.append(("compiler", None, "not needed: the kernels are built at install time"))
    return found


# Distributions that provide one module: any of them will do.
_MODULES = {"opencv-contrib-python-headless": "cv2", "open3d-cpu": "open3d", "open3d": "open3d"}
_OWN_ROWS = ("cuda12", "cuda13", "dev")  # extras left out: the CUDA kernels have their own rows, and users need no developer tools


def _libraries() -> list[tuple[str, bool | None, str]]:
    """The dependencies of the installed e4dgs on this machine: required ones first, then those of its extras."""
    try:
        asked = metadata.requires("e4dgs") or []
    except metadata.PackageNotFoundError:
        return [("libraries", None, "e4dgs runs from its source folder, so its requirements were not checked; pip install . installs them")]
    needed: list[tuple[str, bool | None, str]] = []
    optional: dict[str, tuple[str, bool | None, str]] = {}
    for name, extra in filter(None, map(name_and_extra, asked)):
        version = _version(name)
        if extra is None:
            needed.append((name, version is not None, version or "not installed; install e4dgs again with its dependencies"))
        elif extra not in _OWN_ROWS:
            optional.setdefault(name, (name, version is not None or None, version or f"optional: pip install 'e4dgs[{extra}]'"))
    return needed + list(optional.values())


def name_and_extra(requirement: str) -> tuple[str, str | None] | None:
    """``open3d-cpu>=0.18; platform_system == "Linux" and extra == "usd"`` -> ("open3d-cpu", "usd"); None on machines that need not
    have it, here all but Linux."""
    from packaging.requirements import Requirement

    parsed = Requirement(requirement)
    if parsed.marker is None or parsed.marker.evaluate({"extra": ""}):
        return parsed.name, None
    found = re.search(r"extra == ['\"]([\w-]+)['\"]", str(parsed.marker))
    return (parsed.name, found[1]) if found is not None and parsed.marker.evaluate({"extra": found[1]}) else None


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        module = _MODULES.get(name)
        return f"{module} comes from another distribution" if module is not None and find_spec(module) is not None else None


def _try(check: Callable[[], str]) -> tuple[bool, str]:
    try:
        return True, check()
    except Exception as error:  # a doctor reports whatever is broken
        return False, f"{type(error).__name__}: {error}"


def _lpips() -> tuple[bool | None, str]:
    """A row's ``well`` and detail: LPIPS is optional, so nothing is wrong where its weights are not there."""
    from ...scene.metrics.published_lpips import what_is_there

    there, detail = what_is_there()
    return there or None, detail


def _installed_version() -> str:
    from ... import __version__

    return __version__


def _render() -> str:
    import torch

    from ...rasterizer import Camera, Gaussians, rasterize

    camera = Camera(torch.tensor([[32.0, 0, 16], [0, 32, 16], [0, 0, 1]]), torch.eye(4), 32, 32)
    one = Gaussians(
        torch.tensor([[0.0, 0, 2]]), torch.tensor([[1.0, 0, 0, 0]]), torch.full((1, 3), 0.2), torch.ones(1), colors=torch.ones(1, 3)
    )
    alpha = float(rasterize(camera, gaussians=one, backend="cpu").alpha[16, 16])
    if not 0.9 < alpha <= 0.99:
        raise RuntimeError(f"a test picture has alpha {alpha:.3f} in its middle where about 0.99 is right; install e4dgs again")
    return "load and render a test picture"


def _threads() -> str:
    import torch

    return f"{torch.get_num_threads()} used, {os.cpu_count()} processors, {len(os.sched_getaffinity(0))} allowed"


def _cuda() -> list[tuple[str, bool | None, str]]:
    try:
        from ...rasterizer.cuda.runtime import describe

        return describe()
    except Exception as error:  # torch itself may be broken
        return [("CUDA kernels", False, f"{type(error).__name__}: {error}")]


def _pycolmap() -> str:
    import pycolmap

    return f"version {pycolmap.__version__}"


def _open3d() -> str:
    from ...vision.clouds import load_open3d

    return f"version {load_open3d('export mesh').__version__}"


def _zarr() -> str:
    import tempfile

    import numpy as np

    from ...pipeline import Artifact, ArtifactWriter

    with tempfile.TemporaryDirectory() as folder:
        writer = ArtifactWriter(Path(folder))
        writer.write("x", np.arange(5))
        writer.finish({})
        if Artifact(Path(folder)).read("x").tolist() != [0, 1, 2, 3, 4]:
            raise RuntimeError("an array came back changed; install zarr again")
    return "with checksums"


def _existing(path: Path) -> Path:
    path = path.resolve()
    while not path.exists():
        path = path.parent
    return path
