"""Selects what runs kernels on a device: the CUDA driver, or an emulator that a test has put in its place."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, Protocol

import torch

from .arguments import Argument
from .program import Program


class Launcher(Protocol):
    """Runs kernels on one device, in the order of the calls, on torch's current stream. Does not wait for them to finish."""

    def launch(self, program: Program, kernel: str, blocks: int, threads: int, *arguments: Argument) -> None:
        """Run `kernel` of `program` on a 1D grid of `blocks` blocks of `threads` threads. With 0 blocks, nothing is launched.

        arguments: in the kernel's order. A contiguous tensor on this device is passed as its address, None as a null pointer, a
            ctypes scalar (`ctypes.c_int32(n)`, `ctypes.c_float(x)`) as its value. The kernel's parameters must have exactly these types.
            The caller must keep alive a tensor that was allocated on another stream (`Tensor.record_stream`).

        Raises TypeError and ValueError for bad arguments, naming their position; RuntimeError if the kernel cannot be compiled,
        loaded or launched.
        """
        ...


_REGISTERED: dict[str, Launcher] = {}
_CUDA: dict[int, Launcher] = {}
_LOCK = threading.Lock()


def launcher_for(device: torch.device) -> Launcher:
    """The launcher of a device. Returns the same object each time.

    Raises ValueError if it is not a CUDA device (unless `launching` has registered a launcher for it), RuntimeError with the reason
    if kernels cannot be run on it.
    """
    registered = _REGISTERED.get(device.type)
    if registered is not None:
        return registered
    if device.type != "cuda":
        raise ValueError(f"backend 'cuda' wants tensors on a CUDA device, got {device}; move them with .cuda() or use backend='cpu'")
    index = torch.cuda.current_device() if device.index is None else device.index
    found = _CUDA.get(index)
    if found is None:
        from .available import why_not
        from .cuda_launcher import CudaLauncher

        problem = why_not(index)
        if problem:
            raise RuntimeError(f"backend 'cuda' cannot be used: {problem}")
        with _LOCK:
            found = _CUDA.setdefault(index, CudaLauncher(torch.device("cuda", index)))
    return found


@contextmanager
def launching(device: str | torch.device, launcher: Launcher) -> Iterator[None]:
    """For tests: inside the block, `launcher_for` returns this object for every device of this type, e.g. an emulator for "cpu"."""
    kind = torch.device(device).type
    before = _REGISTERED.get(kind)
    _REGISTERED[kind] = launcher
    try:
        yield
    finally:
        if before is None:
            del _REGISTERED[kind]
        else:
            _REGISTERED[kind] = before


def warm_up(programs: Sequence[Program], device: torch.device) -> None:
    """Compile programs in parallel before they are needed, unless the cache has them. Raises what compiling raises."""
    launcher: Any = launcher_for(device)
    prepare = getattr(launcher, "prepare", None)  # an emulator has nothing to prepare
    if prepare is not None and programs:
        with ThreadPoolExecutor(min(len(programs), os.cpu_count() or 1)) as pool:
            list(pool.map(prepare, programs))
