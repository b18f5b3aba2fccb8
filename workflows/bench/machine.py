"""Describes the machine that a number was measured on, for every result."""

from __future__ import annotations

import os
import platform
import subprocess
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from ..machine.devices import processor

LIBRARIES = ("e4dgs", "torch", "numpy", "pycolmap", "opencv-contrib-python-headless", "zarr")


def machine() -> dict[str, object]:
    """Processor, cores, load before the run, memory, GPU and its driver (unknown without one), compiler, versions, date and commit."""
    import psutil

    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        "memory_gib": round(psutil.virtual_memory().total / 2**30, 1),
        "system": platform.platform(),
        "python": platform.python_version(),
        "gpu": _first_line("nvidia-smi", "--query-gpu=name,driver_version,memory.total", "--format=csv,noheader"),
        "compiler": _first_line(os.environ.get("CXX", "c++"), "--version"),
        "versions": {name: _version(name) for name in LIBRARIES},
        "date": datetime.now(UTC).date().isoformat(),
        "commit": _first_line("git", "rev-parse", "--short", "HEAD"),
    }


def kernels() -> dict[str, object]:
    """Instruction set and threads of the kernels, and OpenMP's wait policy."""
    import torch

    from ...rasterizer import _cpu  # type: ignore[attr-defined]

    return {"kernels": _cpu.kernels(), "threads": torch.get_num_threads(), "omp_wait_policy": os.environ.get("OMP_WAIT_POLICY", "default")}


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _first_line(*command: str) -> str:
    try:
        done = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parent)
    except OSError:
        return "unknown"
    return done.stdout.splitlines()[0] if done.returncode == 0 and done.stdout else "unknown"
