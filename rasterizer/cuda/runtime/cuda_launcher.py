"""Runs kernels on an NVIDIA GPU. They are compiled, or taken from the cache, on first use and launched with cuda-core on torch's stream."""

from __future__ import annotations

import threading
from ctypes import c_double, c_float, c_uint64
from typing import Any, get_args

import torch
from torch import Tensor

from ... import _cpu  # type: ignore[attr-defined]
from . import cache
from .arguments import Argument, Scalar
from .program import Program

MAX_BLOCKS = 2**31 - 1  # along the first axis of a grid
KEPT = 4096  # launch shapes and streams to remember; grid sizes depend on the data, so their number is unbounded
SCALARS = frozenset(get_args(Scalar))
# Passed as a Python int, which cuda-core handles ten times faster than a ctypes object. Hosts with an NVIDIA GPU are little-endian, so the
# first of its 8 bytes hold the number in any narrower type. (The upper half of c_uint64's range would not fit.)
WHOLE = SCALARS - {c_uint64, c_float, c_double}

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
        from cuda.core import Device, LaunchConfig, Stream, launch

        self.device = device
        self.index: int = device.index
        major, minor = torch.cuda.get_device_capability(device)
        self.arch = f"sm_{major}{minor}"
        self._Device, self._LaunchConfig, self._Stream, self._launch = Device, LaunchConfig, Stream, launch
        self._kernels: dict[tuple[Program, str], tuple[Any, int]] = {}  # with their addresses, 0 if they are launched by cuda-core
        self._native = _cpu.can_launch(Tensor, c_float, c_double, c_uint64)
        self._configs: dict[tuple[int, int], Any] = {}
        self._streams: dict[int, Any] = {}

    def launch(self, program: Program, kernel: str, blocks: int, threads: int, *arguments: Argument) -> None:
        if blocks == 0:
            return
        if not 0 < blocks <= MAX_BLOCKS:
            raise ValueError(
                f"kernel {kernel} wants {blocks} blocks, and a grid has at most {MAX_BLOCKS}; render fewer primitives or pixels"
            )
        if torch.cuda.current_device() == self.index and self.index in _THREAD.devices:
            self._run(program, kernel, blocks, threads, arguments)
            return
        with torch.cuda.device(self.index):
            if self.index not in _THREAD.devices:
                # A thread has no context until torch's first runtime call in it, and in autograd's threads our launch may come first. The
                # context stays current: torch uses the same (primary) contexts when it switches devices later.
                self._Device(self.index).set_current()
                _THREAD.devices.add(self.index)
            self._run(program, kernel, blocks, threads, arguments)

    def prepare(self, program: Program) -> None:
        """Compile a program, or find it in the cache, without loading it."""
        cache.compiled(program, self.arch)

    def _run(self, program: Program, kernel: str, blocks: int, threads: int, arguments: tuple[Argument, ...]) -> None:
        ready, address = self._kernels.get((program, kernel)) or self._load(program, kernel)
        handle = _current_stream(self.index)
        # What is wrong with a launch that fails here, the slow way below finds out and says.
        if address and _cpu.launch(address, blocks, threads, handle, self.index, arguments) == 0:
            return
        values = self._values(kernel, arguments)
        config = self._configs.get((blocks, threads))
        if config is None:
            config = _remember(self._configs, (blocks, threads), self._LaunchConfig(grid=blocks, block=threads))
        stream = self._streams.get(handle)
        if stream is None:
            stream = _remember(self._streams, handle, self._Stream.from_handle(handle))
        try:
            self._launch(stream, config, ready, *values)
        except Exception as cause:  # cuda-core's CUDAError has no public name
            raise RuntimeError(
                f"kernel {kernel} of {program} was not launched on {self.device} (grid {blocks}, block {threads}): {cause}. The error may "
                "be an earlier kernel's; run again with CUDA_LAUNCH_BLOCKING=1 to have it named"
            ) from cause

    def _values(self, kernel: str, arguments: tuple[Argument, ...]) -> list[Any]:
        """The arguments for cuda-core. An int is 8 bytes, of which the driver reads the parameter's width; others keep their own width."""
        values: list[Any] = []
        for argument in arguments:
            if argument is None:
                values.append(0)
            elif isinstance(argument, Tensor):
                if argument.get_device() != self.index:
                    raise ValueError(f"{_place(values, kernel)} is on {argument.device}, and the kernel runs on {self.device}")
                if not argument.is_contiguous():
                    raise ValueError(f"{_place(values, kernel)} is not contiguous; pass it through .contiguous()")
                values.append(argument.data_ptr())
            elif type(argument) in WHOLE:
                values.append(argument.value)
            elif type(argument) in SCALARS:
                values.append(argument)
            else:
                raise TypeError(
                    f"{_place(values, kernel)} must be a tensor, None or a ctypes scalar of fixed width such as ctypes.c_int32, got "
                    f"{type(argument).__name__}"
                )
        return values

    def _load(self, program: Program, kernel: str) -> tuple[Any, int]:
        from cuda.core import ObjectCode

        if torch.cuda.is_current_stream_capturing():
            raise RuntimeError(
                f"kernel {kernel} of {program} is used for the first time inside a CUDA graph capture, where nothing can be loaded; run "
                "the same pass once before capturing it"
            )
        with _LOCK:
            library = _LIBRARIES.get((program, self.arch))
            if library is None:
                code = cache.compiled(program, self.arch)
                load = ObjectCode.from_ptx if code.form == "ptx" else ObjectCode.from_cubin
                library = _LIBRARIES[program, self.arch] = load(code.code, name=str(program))
            try:
                ready = library.get_kernel(kernel)
            except Exception as cause:
                known = ", ".join(cache.compiled(program, self.arch).resources) or "none"
                raise RuntimeError(
                    f"kernel {kernel} of {program} could not be loaded on {self.device}: {cause}; the program has {known}"
                ) from cause
        self._kernels[program, kernel] = found = ready, int(ready.handle) if self._native else 0
        return found


def _stream_object(index: int) -> int:
    return int(torch.cuda.current_stream(index).cuda_stream)


# torch's own code and Triton ask like this, without making an object for the stream.
_current_stream = getattr(torch._C, "_cuda_getCurrentRawStream", _stream_object)


def _place(before: list[Any], kernel: str) -> str:
    return f"argument {len(before)} of kernel {kernel}"


def _remember(kept: dict[Any, Any], key: Any, value: Any) -> Any:
    if len(kept) >= KEPT:
        kept.clear()
    kept[key] = value
    return value
