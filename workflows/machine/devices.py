"""Which device a run computes on, decided without importing torch."""

from __future__ import annotations

import ctypes
import ctypes.util
import hashlib
import os
import platform
import re
import subprocess
import sys
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

from ...pipeline import SettingsError
from ...pipeline.code.parse_cache import cache_folder

DEVICES = ("auto", "cpu", "cuda")
SELFTEST_SECONDS = 300  # time limit; the first self-test also compiles the kernels
PACKAGE = Path(__file__).resolve().parents[2]
KERNELS = ("rasterizer/cuda", "rasterizer/math", "scene/cuda")  # folders of all that computes on a GPU, and of the self-test
EXTRAS = "install e4dgs[cuda13], or e4dgs[cuda12] where torch.version.cuda starts with 12"
NVRTC_PACKAGES = ("nvidia.cu13", "nvidia.cuda_nvrtc")  # modules of NVRTC in NVIDIA's wheels for CUDA 13 and 12
TOOLKITS = ("CUDA_HOME", "CUDA_PATH", "CONDA_PREFIX")  # environment variables that name a toolkit's folder
SYSTEM_TOOLKIT = "/usr/local/cuda"


def resolve_device(choice: str) -> str:
    """``auto`` -> "cuda" if it can be used, else "cpu". Raises SettingsError with the reason if ``cuda`` cannot be used."""
    if choice not in DEVICES:
        raise SettingsError(f"--device {choice}: choose one of {', '.join(DEVICES)}")
    if choice == "cpu":
        return "cpu"
    problem = why_not_cuda() or why_not_trusted()
    if choice == "cuda" and problem:
        raise SettingsError(f"--device cuda: {problem}; use --device cpu")
    return "cpu" if problem else "cuda"


def why_not_cuda() -> str | None:
    """Why CUDA cannot be used here, or None if it can. Only checks what is visible without importing torch or loading NVRTC;
    `e4dgs.rasterizer.cuda.runtime.why_not` checks the rest when the kernels are used."""
    spec = find_spec("torch")
    if spec is None or spec.origin is None:
        return "torch is not installed"
    version = (Path(spec.origin).parent / "version.py").read_text()
    if not re.search(r"^cuda\b[^=]*= *['\"]", version, re.MULTILINE):
        return "the installed torch was built without CUDA"
    if not _is_there("cuda.bindings.nvrtc"):
        return f"cuda-bindings is not installed; {EXTRAS}"
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


def why_not_trusted() -> str | None:
    """Why the GPU cannot be trusted, or None if a small render and a training step on it agree with the CPU's. They run in a separate
    process. Agreement is remembered for these kernels, torch and driver."""
    proof = _proof()
    if proof is not None and proof.is_file():
        return None
    command = [sys.executable, "-m", "e4dgs.scene.selftest"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=SELFTEST_SECONDS)
    except (OSError, subprocess.TimeoutExpired) as cause:
        return f"a small training step on the GPU did not finish: {type(cause).__name__}"
    if done.returncode:
        said = (done.stdout.strip() or done.stderr.strip() or f"exit code {done.returncode}").splitlines()[-1]
        return f"a small training step on the GPU went wrong: {said}"
    if proof is not None:
        with suppress(OSError):  # the check is then repeated next time
            proof.parent.mkdir(parents=True, exist_ok=True)
            proof.touch()
    return None


def _proof() -> Path | None:
    """A file that exists once these CUDA kernels, with this torch and driver, have agreed with the CPU's on this machine. None if there is
    no folder for it."""
    state = hashlib.sha256()
    for path in sorted(path for folder in KERNELS for path in (PACKAGE / folder).rglob("*")):
        if path.suffix in (".cu", ".cuh", ".h", ".py"):
            state.update(path.relative_to(PACKAGE).as_posix().encode() + path.read_bytes())
    spec, driver = find_spec("torch"), ctypes.c_int(0)
    assert spec is not None and spec.origin is not None
    state.update((Path(spec.origin).parent / "version.py").read_bytes())
    ctypes.CDLL("libcuda.so.1").cuDriverGetVersion(ctypes.byref(driver))
    state.update(f"{driver.value} {os.environ.get('CUDA_VISIBLE_DEVICES')}".encode())
    folder = cache_folder()
    return folder / f"cuda-agrees-{state.hexdigest()[:20]}" if folder is not None else None


def processor() -> str:
    """The processor's name, or at least its kind."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _is_there(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ImportError:  # a package above it is missing or broken
        return False


def _nvrtc_is_there() -> bool:
    """Whether NVRTC is in its own package, in a toolkit, or where the system's loader looks. torch's CUDA builds bring the package."""
    if any(_is_there(package) for package in NVRTC_PACKAGES):
        return True
    roots = [*(os.environ.get(name, "") for name in TOOLKITS), SYSTEM_TOOLKIT]
    folders = [Path(root) / folder for root in roots if root for folder in ("lib64", "lib")]
    return any(any(folder.glob("libnvrtc.so*")) for folder in folders) or ctypes.util.find_library("nvrtc") is not None
