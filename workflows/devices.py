"""Which device a run computes on, decided without importing torch."""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import re
from importlib.util import find_spec
from pathlib import Path

from ..pipeline import SettingsError

DEVICES = ("auto", "cpu", "cuda")
TRAINS_ON_CUDA = False  # True once the stages hand the rasterizer CUDA tensors
EXTRAS = "install e4dgs[cuda13], or e4dgs[cuda12] where torch.version.cuda starts with 12"
NVRTC_PACKAGES = ("nvidia.cu13", "nvidia.cuda_nvrtc")  # where NVIDIA's wheels for CUDA 13 and 12 put it
TOOLKITS = ("CUDA_HOME", "CUDA_PATH", "CONDA_PREFIX")  # environment variables with the folder of one
SYSTEM_TOOLKIT = "/usr/local/cuda"


def resolve_device(choice: str) -> str:
    """``auto`` -> "cuda" where it can be used, else "cpu". Raises SettingsError for ``cuda`` where it cannot, with the reason."""
    if choice not in DEVICES:
        raise SettingsError(f"--device {choice}: choose one of {', '.join(DEVICES)}")
    if choice == "cpu":
        return "cpu"
    problem = why_not_cuda() or why_not_training()
    if choice == "cuda" and problem:
        raise SettingsError(f"--device cuda: {problem}; use --device cpu")
    return "cpu" if problem else "cuda"


def why_not_cuda() -> str | None:
    """Why CUDA cannot be used here, or None when it can. Checks what can be seen without importing torch or loading NVRTC;
    `e4dgs.rasterizer.cuda.available.why_not` checks the rest where the kernels are used."""
    spec = find_spec("torch")
    if spec is None or spec.origin is None:
        return "torch is not installed"
    version = (Path(spec.origin).parent / "version.py").read_text()
    if not re.search(r"^cuda\b[^=]*= *['\"]", version, re.MULTILINE):
        return "the installed torch was built without CUDA"
    for module, package in (("cuda.core", "cuda-core"), ("cuda.bindings.nvrtc", "cuda-bindings")):
        if not _is_there(module):
            return f"{package} is not installed; {EXTRAS}"
    if not _nvrtc_is_there():
        return f"NVRTC, which compiles the kernels, was not found; {EXTRAS}"
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return "no NVIDIA driver was found (libcuda.so.1)"
    count = ctypes.c_int(0)
    if driver.cuInit(0) != 0 or driver.cuDeviceGetCount(ctypes.byref(count)) != 0 or count.value == 0:
        return "the NVIDIA driver finds no device"
    return None


def why_not_training() -> str | None:
    """Why nothing is trained on CUDA even where the kernels can be used, or None."""
    return None if TRAINS_ON_CUDA else "training on CUDA is not wired in this version"


def _is_there(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ImportError:  # a package above it is missing or broken
        return False


def _nvrtc_is_there() -> bool:
    """In a package of its own, in a toolkit, or where the system's loader looks; torch's CUDA builds bring the package."""
    if any(_is_there(package) for package in NVRTC_PACKAGES):
        return True
    roots = [*(os.environ.get(name, "") for name in TOOLKITS), SYSTEM_TOOLKIT]
    folders = [Path(root) / folder for root in roots if root for folder in ("lib64", "lib")]
    return any(any(folder.glob("libnvrtc.so*")) for folder in folders) or ctypes.util.find_library("nvrtc") is not None
