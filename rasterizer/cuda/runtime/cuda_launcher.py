"""Runs kernels on an NVIDIA GPU. They are compiled, or taken from the cache, on first use, loaded by the driver, and launched from C++ on
torch's stream."""

from __future__ import annotations

import threading
from ctypes import c_double, c_float, c_uint64
from typing import Any, get_args

import torch
from torch import Tensor

from ... import _cpu  # type: ignore[attr-defined]
from . import cache
from .arguments import Argument, Scalar
from .compiler import Compiled
from .program import Program
from .stream import current_stream

MAX_BLOCKS = 2**31 - 1  # along the first axis of a grid
SCALARS = frozenset(get_args(Scalar))

# A loaded library (CUlibrary) belongs to the process, not to a device: its kernels run in the context of the stream or, for the
# default stream, in the current context. So GPUs of the same architecture share it.
_LIBRARIES: dict[tuple[Program, str], Any] = {}
_LOCK = threading.Lock()


class _Thread(threading.local):
    """The devices whose context has been made current in this thread."""

    def __init__(self) -> None:
        self.devices: set[int] = set()


_THREAD = _Thread()


class CudaLauncher:
    """See `Launcher`. There is one per device, and any thread may use it. A launch does not synchronise or allocate on the device, so it
    can be captured in a CUDA graph, provided that its kernel has been launched before."""

    def __init__(self, device: torch.device) -> None:
        from cuda.bindings import driver

        self.device = device
        self.index: int = device.index
        major, minor = torch.cuda.get_device_capability(device)
        self.arch = f"sm_{major}{minor}"
        self._driver = driver
        _done(driver, "initialise the driver", driver.cuInit(0))
        if not _cpu.can_launch(Tensor, c_float, c_double, c_uint64):
            raise RuntimeError("the NVIDIA driver's library libcuda.so.1 has no cuLaunchKernel; install the driver again")
        self._context = _done(driver, f"make a context on {device}", driver.cuDevicePrimaryCtxRetain(self.index))
        self._kernels: dict[tuple[Program, str], int] = {}

    def launch(self, program: Program, kernel: str, blocks: int, threads: int, *arguments: Argument) -> None:
        if blocks == 0:
            return
        if not 0 < blocks <= MAX_BLOCKS:
            raise ValueError(
                f"kernel {kernel} wants {blocks} blocks, and a grid has at most {MAX_BLOCKS}; render fewer primitives or pixels"
            )
        if _current_device() == self.index and self.index in _THREAD.devices:
            self._run(program, kernel, blocks, threads, arguments)
            return
        with torch.cuda.device(self.index):
            if self.index not in _THREAD.devices:
                # A thread has no context until torch's first runtime call in it, and in autograd's threads our launch may come first. The
                # context stays current: torch uses the same (primary) contexts when it switches devices later.
                _done(self._driver, f"use the context of {self.device}", self._driver.cuCtxSetCurrent(self._context))
                _THREAD.devices.add(self.index)
            self._run(program, kernel, blocks, threads, arguments)

    def prepare(self, program: Program) -> None:
        """Compile a program, or find it in the cache, without loading it."""
        cache.compiled(program, self.arch)

    def _run(self, program: Program, kernel: str, blocks: int, threads: int, arguments: tuple[Argument, ...]) -> None:
        address = self._kernels.get((program, kernel)) or self._load(program, kernel)
        status = _cpu.launch(address, blocks, threads, current_stream(self.index), self.index, arguments)
        if status == 0:
            return
        self._check(kernel, arguments)
        raise RuntimeError(
            f"kernel {kernel} of {program} was not launched on {self.device} (grid {blocks}, block {threads}): "
            f"{_what(self._driver, status)}. The error may be an earlier kernel's; run again with CUDA_LAUNCH_BLOCKING=1 to have it named"
        )

    def _check(self, kernel: str, arguments: tuple[Argument, ...]) -> None:
        """Raise if an argument is none for a kernel on this device."""
        for place, argument in enumerate(arguments):
            where = f"argument {place} of kernel {kernel}"
            if isinstance(argument, Tensor):
                if argument.get_device() != self.index:
                    raise ValueError(f"{where} is on {argument.device}, and the kernel runs on {self.device}")
                if not argument.is_contiguous():
                    raise ValueError(f"{where} is not contiguous; pass it through .contiguous()")
            elif argument is not None and type(argument) not in SCALARS:
                raise TypeError(
                    f"{where} must be a tensor, None or a ctypes scalar of fixed width such as ctypes.c_int32, got "
                    f"{type(argument).__name__}"
                )

    def _load(self, program: Program, kernel: str) -> int:
        if torch.cuda.is_current_stream_capturing():
            raise RuntimeError(
                f"kernel {kernel} of {program} is used for the first time inside a CUDA graph capture, where nothing can be loaded; run "
                "the same pass once before capturing it"
            )
        code = cache.compiled(program, self.arch)
        what = f"load kernel {kernel} of {program} on {self.device}; the program has {', '.join(code.resources) or 'none that are known'}"
        with _LOCK:
            library = _LIBRARIES.get((program, self.arch))
            if library is None:
                library = _LIBRARIES[program, self.arch] = _done(self._driver, what, _library(self._driver, code))
            found = _done(self._driver, what, self._driver.cuLibraryGetKernel(library, kernel.encode()))
        self._kernels[program, kernel] = address = int(found)
        return address


def _library(driver: Any, code: Compiled) -> tuple[Any, ...]:
    text = code.code + b"\0" if code.form == "ptx" else code.code  # the driver reads PTX up to a zero
    found: tuple[Any, ...] = driver.cuLibraryLoadData(text, [], [], 0, [], [], 0)
    return found


def _done(driver: Any, what: str, result: tuple[Any, ...]) -> Any:
    """The value of a call of the driver. Raises RuntimeError if it failed."""
    status, *values = result
    if int(status) != 0:
        raise RuntimeError(f"the NVIDIA driver could not {what}: {_what(driver, int(status))}")
    return values[0] if values else None


def _what(driver: Any, status: int) -> str:
    """The name and the words of an error of the driver."""
    try:
        error = driver.CUresult(status)
        name, words = driver.cuGetErrorName(error)[1], driver.cuGetErrorString(error)[1]
    except Exception:  # a number that these bindings do not know
        return f"error {status}"
    return f"{name.decode()} ({words.decode()})"


_current_device = getattr(torch._C, "_cuda_getDevice", torch.cuda.current_device)
