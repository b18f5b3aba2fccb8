"""Whether the CUDA kernels can be used on this machine, and what `e4dgs doctor` reports about their requirements."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from . import cache
from .compiler import architectures, compile_cubin, load_nvrtc, nvrtc_version, target_of
from .program import Program

OLDEST = (7, 5)  # the oldest compute capability that CUDA 13 still compiles for
TRIVIAL = 'extern "C" __global__ void fill(float* out) { out[threadIdx.x] = 1.0f; }\n'

Row = tuple[str, bool | None, str]


def why_not(device_index: int | None = None) -> str | None:
    """One line that says why the CUDA kernels cannot be used and what to do, or None if they can. Initialises CUDA if there is a device.

    device_index: torch's index of the device; None for the first one.
    """
    try:
        return _problem(0 if device_index is None else device_index)
    except Exception as error:  # a driver can fail in many ways, and the answer is always the same
        return f"CUDA fails here: {_first_line(error)}; see `e4dgs doctor`"


def describe() -> list[Row]:
    """(what, well, detail) rows for `e4dgs doctor`. `well` is None for a fact that is neither good nor bad. Never raises."""
    rows = [_row("CUDA kernels", _usable), _row("CUDA driver", _driver)]
    rows += _devices()
    compiles = _row("CUDA compiler (NVRTC)", _nvrtc)
    rows.append(compiles)
    if compiles[1]:
        rows.append(_row("CUDA kernel compiles", _compiles))
    rows.append(_row("CUDA kernel cache", _cache))
    return rows


def driver_version() -> tuple[int, int] | None:
    """(major, minor) of the newest CUDA version that the driver supports. None without a driver or cuda-bindings."""
    try:
        from cuda.bindings import driver

        status, version = driver.cuDriverGetVersion()
    except Exception:  # ImportError, or cuda-pathfinder's "not found"
        return None
    return (version // 1000, version % 1000 // 10) if status == driver.CUresult.CUDA_SUCCESS and version else None


def _problem(index: int) -> str | None:
    import torch

    if torch.version.cuda is None:
        return "the installed torch was built without CUDA; install one with it (https://pytorch.org/get-started/locally)"
    try:
        load_nvrtc()
    except RuntimeError as error:
        return _first_line(error)
    driver, compiler = driver_version(), nvrtc_version()
    if driver is None:
        return "no NVIDIA driver was found; install one (https://www.nvidia.com/drivers)"
    count = torch.cuda.device_count()
    if count == 0:
        return "the NVIDIA driver finds no device that torch can use; look at nvidia-smi and at CUDA_VISIBLE_DEVICES"
    if index >= count:
        return f"there is no CUDA device {index}, the last one is {count - 1}"
    if driver[0] < compiler[0]:
        return (
            f"the NVIDIA driver supports CUDA {_dotted(driver)} and does not load what NVRTC {_dotted(compiler)} compiles; "
            f"update the driver, or install e4dgs[cuda{driver[0]}] and a torch for CUDA {driver[0]}"
        )
    capability = torch.cuda.get_device_capability(index)
    if capability < OLDEST:
        name = torch.cuda.get_device_name(index)
        return f"{name} has compute capability {_dotted(capability)}, and the kernels want {_dotted(OLDEST)} or newer"
    target = target_of(f"sm_{capability[0]}{capability[1]}")  # raises RuntimeError if the device is too old for this NVRTC
    if target.startswith("compute_") and driver < compiler:
        return (
            f"NVRTC {_dotted(compiler)} does not know compute capability {_dotted(capability)}, and the driver (CUDA {_dotted(driver)}) is "
            "older than NVRTC and cannot finish its code; update the driver"
        )
    return None


def _usable() -> tuple[bool | None, str]:
    problem = why_not()
    return (True, "usable") if problem is None else (None, problem)


def _driver() -> tuple[bool | None, str]:
    version = driver_version()
    return (None, "not found") if version is None else (True, f"supports CUDA {_dotted(version)}")


def _devices() -> list[Row]:
    try:
        import torch

        count = torch.cuda.device_count()
    except Exception as error:
        return [("CUDA devices", False, _first_line(error))]
    return [_row(f"CUDA device {index}", lambda index=index: _device(index)) for index in range(count)]  # type: ignore[misc]


def _device(index: int) -> tuple[bool | None, str]:
    import torch

    about = torch.cuda.get_device_properties(index)
    known = f"{about.name}, compute capability {about.major}.{about.minor}, {about.total_memory / 2**30:.0f} GiB"
    try:
        target = target_of(f"sm_{about.major}{about.minor}")
    except RuntimeError as error:
        return None, f"{known}; {_first_line(error)}"
    return True, f"{known}; compiled for {target}" + (" and finished by the driver" if target.startswith("compute_") else "")


def _nvrtc() -> tuple[bool | None, str]:
    try:
        load_nvrtc()
    except RuntimeError as error:
        return None, _first_line(error)
    from cuda.pathfinder import load_nvidia_dynamic_lib

    known = architectures()
    path = load_nvidia_dynamic_lib("nvrtc").abs_path
    return True, f"{_dotted(nvrtc_version())}, sm_{known[0]} to sm_{known[-1]}, from {path}"


def _compiles() -> tuple[bool | None, str]:
    import torch

    arch = "sm_90"
    if torch.cuda.is_available():
        arch = "sm_{}{}".format(*torch.cuda.get_device_capability(0))
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "fill.cu"
        source.write_text(TRIVIAL)
        start = time.perf_counter()
        compiled = compile_cubin(Program(source, includes=()), arch)
    return True, f"a trivial one for {arch}, to {len(compiled.code)} bytes of {compiled.form} in {time.perf_counter() - start:.2f} s"


def _cache() -> tuple[bool | None, str]:
    files, size = cache.usage()
    return None, f"{cache.folder()}: {files} files, {size / 2**20:.1f} of at most {cache.LIMIT // 2**20} MiB"


def _row(what: str, check: Callable[[], tuple[bool | None, str]]) -> Row:
    try:
        well, detail = check()
    except Exception as error:  # the doctor reports anything that is broken
        well, detail = False, f"{type(error).__name__}: {_first_line(error)}"
    return what, well, detail


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def _dotted(version: tuple[int, ...]) -> str:
    return ".".join(map(str, version))
