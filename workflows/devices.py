"""Which device a run computes on, decided without importing torch."""

from __future__ import annotations

import ctypes
import re
from importlib.util import find_spec
from pathlib import Path

from ..pipeline import SettingsError

DEVICES = ("auto", "cpu", "cuda")


def resolve_device(choice: str) -> str:
    """``auto`` -> "cuda" where it can be used, else "cpu". Raises SettingsError for ``cuda`` where it cannot, with the reason."""
    if choice not in DEVICES:
        raise SettingsError(f"--device {choice}: choose one of {', '.join(DEVICES)}")
    if choice == "cpu":
        return "cpu"
    problem = why_not_cuda()
    if choice == "cuda" and problem:
        raise SettingsError(f"--device cuda: {problem}; use --device cpu")
    return "cpu" if problem else "cuda"


def why_not_cuda() -> str | None:
    """Why CUDA cannot be used here, or None when it can."""
    if not (Path(__file__).resolve().parents[1] / "rasterizer" / "cuda_backend.py").is_file():
        return "this version has no CUDA kernels"
    spec = find_spec("torch")
    if spec is None or spec.origin is None:
        return "torch is not installed"
    version = (Path(spec.origin).parent / "version.py").read_text()
    if not re.search(r"^cuda\b[^=]*= *['\"]", version, re.MULTILINE):
        return "the installed torch was built without CUDA"
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return "no NVIDIA driver was found (libcuda.so.1)"
    count = ctypes.c_int(0)
    if driver.cuInit(0) != 0 or driver.cuDeviceGetCount(ctypes.byref(count)) != 0 or count.value == 0:
        return "the NVIDIA driver finds no device"
    return None
