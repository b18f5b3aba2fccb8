"""Compiles kernels to machine code with NVRTC.

Uses only the `nvrtc` module of cuda-bindings, which needs no driver: so machines without a GPU (CI, a build host) compile, too.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

from .program import Program

# No fast math: kernels choose their approximations themselves. -v makes ptxas report what each kernel uses.
FLAGS = ("--std=c++20", "--fmad=true", "--ptxas-options=-v")
INSTALL = "install what compiles the kernels with pip install 'e4dgs[cuda13]', or 'e4dgs[cuda12]' where torch.version.cuda starts with 12"
SHOWN = 12  # lines of the log to show when a compilation fails


@dataclass(frozen=True)
class Resources:
    """What a kernel uses on one architecture. Bytes are per thread, except for (static) shared memory, which is per block."""

    registers: int
    spill_bytes: int  # stores and loads of registers that did not fit
    stack_bytes: int
    shared_bytes: int


@dataclass(frozen=True)
class Compiled:
    """A program compiled for one architecture. The driver finishes compiling PTX, so the resources of its kernels are unknown here."""

    code: bytes
    form: Literal["cubin", "ptx"]
    resources: dict[str, Resources]


def compile_cubin(program: Program, arch: str) -> Compiled:
    """Compile a program for an architecture such as "sm_90".

    An architecture that this NVRTC does not know yet gets PTX for the newest older one, which the driver compiles on loading.

    Raises RuntimeError if NVRTC is not installed (and says what to install), if it knows only newer architectures, or if the program
    has errors (and shows the first of them).
    """
    nvrtc = load_nvrtc()
    target = target_of(arch)
    folders = (program.source.parent, *program.includes)
    options = [f"--gpu-architecture={target}", *FLAGS, *(f"-D{name}={value}" for name, value in sorted(program.defines))]
    options += [f"-I{os.fspath(folder)}" for folder in folders]
    text = program.source.read_bytes()
    handle = _check(nvrtc, nvrtc.nvrtcCreateProgram(text, os.fsencode(program.source), 0, None, None))
    try:
        status = nvrtc.nvrtcCompileProgram(handle, len(options), [os.fsencode(option) for option in options])[0]
        log = _text(nvrtc, nvrtc.nvrtcGetProgramLogSize, nvrtc.nvrtcGetProgramLog, handle).rstrip(b"\0 \n").decode(errors="replace")
        if status != nvrtc.nvrtcResult.NVRTC_SUCCESS:
            raise RuntimeError(_complaint(program, target, status, log))
        if target.startswith("compute_"):
            return Compiled(_text(nvrtc, nvrtc.nvrtcGetPTXSize, nvrtc.nvrtcGetPTX, handle), "ptx", {})
        return Compiled(_text(nvrtc, nvrtc.nvrtcGetCUBINSize, nvrtc.nvrtcGetCUBIN, handle), "cubin", resources_in(log))
    finally:
        nvrtc.nvrtcDestroyProgram(handle)


@lru_cache(maxsize=1)
def nvrtc_version() -> tuple[int, int]:
    """(major, minor) of the CUDA release that NVRTC belongs to. Raises RuntimeError if it is not installed."""
    nvrtc = load_nvrtc()
    status, major, minor = nvrtc.nvrtcVersion()
    _check(nvrtc, (status,))
    return int(major), int(minor)


@lru_cache(maxsize=1)
def architectures() -> tuple[int, ...]:
    """The architectures that this NVRTC compiles for, in ascending order, e.g. (75, 80, 86, 90)."""
    nvrtc = load_nvrtc()
    return tuple(sorted(_check(nvrtc, nvrtc.nvrtcGetSupportedArchs())))


def target_of(arch: str) -> str:
    """The target for a device of this architecture: the same if NVRTC knows it, else PTX ("compute_90") of the newest older one."""
    match = re.fullmatch(r"sm_(\d+)", arch)
    if match is None:
        raise ValueError(f"an architecture is sm_ and a number, e.g. sm_90, got {arch!r}")
    wanted, known = int(match[1]), architectures()
    if wanted in known:
        return arch
    older = [number for number in known if number < wanted]
    if not older:
        version = ".".join(map(str, nvrtc_version()))
        raise RuntimeError(f"NVRTC {version} compiles for sm_{known[0]} and newer, and this device is {arch}; use backend='cpu'")
    return f"compute_{older[-1]}"


@lru_cache(maxsize=1)
def load_nvrtc() -> Any:
    """The module `cuda.bindings.nvrtc` with its library loaded. Raises RuntimeError and says what to install if that fails."""
    try:
        from cuda.bindings import nvrtc

        status = nvrtc.nvrtcVersion()[0]  # the library is located on the first call
    except Exception as cause:  # ImportError, or one of cuda-pathfinder's own
        raise RuntimeError(
            f"NVRTC was not found ({str(cause).splitlines()[0] if str(cause) else type(cause).__name__}); {INSTALL}"
        ) from cause
    if status != nvrtc.nvrtcResult.NVRTC_SUCCESS:
        raise RuntimeError(f"NVRTC does not answer ({status.name}); {INSTALL}")
    return nvrtc


def resources_in(log: str) -> dict[str, Resources]:
    """What ptxas reported about each kernel, by name.

    Functions that were not inlined are listed separately, without their callers, so their spills are added to every kernel.
    """
    found: dict[str, dict[str, int]] = {}
    elsewhere, kernel, function = 0, "", ""
    for line in log.splitlines():
        if match := re.search(r"Compiling entry function '([^']+)'", line):
            kernel = match[1]
            found[kernel] = dict.fromkeys(("registers", "spill_bytes", "stack_bytes", "shared_bytes"), 0)
        elif match := re.search(r"Function properties for (\S+)", line):
            function = match[1]
        elif match := re.search(r"(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+) bytes spill loads", line):
            stack, spills = int(match[1]), int(match[2]) + int(match[3])
            if function in found:
                found[function] |= {"spill_bytes": spills, "stack_bytes": max(stack, found[function]["stack_bytes"])}
            else:
                elsewhere += spills
        elif (match := re.search(r"Used (\d+) registers", line)) and kernel:
            used = found[kernel]
            used["registers"] = int(match[1])
            for name, pattern in (("shared_bytes", r"(\d+) bytes smem"), ("stack_bytes", r"(\d+) bytes cumulative stack size")):
                if match := re.search(pattern, line):
                    used[name] = max(used[name], int(match[1]))
    return {name: Resources(**used | {"spill_bytes": used["spill_bytes"] + elsewhere}) for name, used in sorted(found.items())}


def _text(nvrtc: Any, size: Any, get: Any, handle: Any) -> bytes:
    buffer = bytes(_check(nvrtc, size(handle)))
    _check(nvrtc, get(handle, buffer))  # cuda-bindings fills the object itself
    return buffer


def _check(nvrtc: Any, answer: tuple[Any, ...]) -> Any:
    """The value returned along with NVRTC's status. Raises RuntimeError if the status is an error."""
    status, *values = answer
    if status != nvrtc.nvrtcResult.NVRTC_SUCCESS:
        raise RuntimeError(f"NVRTC failed: {status.name}; {INSTALL}")
    return values[0] if values else None


def _complaint(program: Program, target: str, status: Any, log: str) -> str:
    lines = log.splitlines()
    first = next((place for place, line in enumerate(lines) if re.search(r"\berror\b", line)), 0)
    version = ".".join(map(str, nvrtc_version()))
    return (
        f"{program} does not compile for {target} (NVRTC {version}, {status.name}):\n"
        + "\n".join(lines[first : first + SHOWN])
        + f"\nThe source is {program.source}; correct it, or, if you did not change it, install e4dgs again and report this text"
    )
