"""A CUDA device where there is none, to see whether code keeps its tensors on one.

    from pretend_cuda import pretending_cuda

    with pretending_cuda() as pretending:
        x = torch.zeros(3, device="cuda")  # or .cuda(), .to("cuda"), module.to("cuda"): x.device is cuda:0
        x + torch.ones(3)  # RuntimeError, as on hardware
        x.sum().item()  # pretending.syncs == [Sync("item", "tests/...:6")]

Tensors there are of a subclass that autograd takes for ones of another device; their numbers are on the CPU. The kernels of e4dgs run in
the emulator, which refuses tensors of the CPU here. Waiting is counted as on hardware, where a blocking copy to the device waits as well.
What is not pretended: streams and time (an event has happened when it is asked for again), graphs, CUDA's own numerics and the types it
lacks, `torch.Generator` on the device, pinned memory, and `x.data = y` of another shape. Messages of autograd call the device "meta".
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from ctypes import _SimpleCData
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import torch
from e4dgs.rasterizer.cuda.runtime import launching
from pretended import methods, syncs
from pretended.event import Event
from pretended.rules import Mode
from pretended.syncs import Sync
from pretended.tensor import CUDA, Pretended
from simt import Emulator
from torch import Tensor

__all__ = ["Pretended", "Pretending", "Sync", "pretending_cuda"]


class Pretending:
    """What happened since `pretending_cuda` was entered.

    syncs: see `Sync`; may be cleared. kernels: names of those that were launched.
    """

    def __init__(self) -> None:
        self.syncs: list[Sync] = []
        self.kernels: list[str] = []


class _Launcher:
    """Gives an emulator the memory of tensors on the device that is pretended."""

    def __init__(self, emulator: Any, pretending: Pretending) -> None:
        self.emulator, self.pretending = emulator, pretending

    def launch(self, program: Any, kernel: str, blocks: int, threads: int, *arguments: Tensor | _SimpleCData | None) -> None:
        plain = []
        for place, argument in enumerate(arguments):
            if isinstance(argument, Tensor) and not isinstance(argument, Pretended):
                shape = f"{argument.dtype} {list(argument.shape)}"
                raise ValueError(f"{kernel}: argument {place} ({shape}) is on {argument.device}, the kernel runs on {CUDA}")
            plain.append(argument.numbers if isinstance(argument, Pretended) else argument)
        self.pretending.kernels.append(kernel)
        self.emulator.launch(program, kernel, blocks, threads, *plain)


@contextmanager
def pretending_cuda(seed: int = 0, emulator: Any = None) -> Iterator[Pretending]:
    """Inside, there is a device `cuda:0` whose kernels run in `emulator`, or one in the order of threads of this seed."""
    if torch.cuda.is_available():
        torch.cuda.init()  # or the first tensor that is asked for here would pass for that
    pretending = Pretending()
    launcher = _Launcher(emulator or Emulator(seed), pretending)
    with ExitStack() as stack:
        for name, value in _answers().items():
            stack.enter_context(patch.object(torch.cuda, name, value))
        stack.enter_context(methods.patched())
        future = torch.__future__
        # `module.to` keeps the module's very parameters, as it does between devices that torch knows.
        stack.enter_context(_set(future.get_swap_module_params_on_conversion, future.set_swap_module_params_on_conversion))
        stack.enter_context(launching("cuda", launcher))
        syncs.NOTED.append(pretending.syncs)
        stack.callback(_forget, pretending.syncs)
        stack.enter_context(Mode())
        yield pretending


def _forget(notes: list[Sync]) -> None:
    syncs.NOTED[:] = [other for other in syncs.NOTED if other is not notes]


@contextmanager
def _set(get: Callable[[], bool], put: Callable[[bool], None]) -> Iterator[None]:
    before = get()
    put(True)
    try:
        yield
    finally:
        put(before)


def _answers() -> dict[str, Any]:
    """What torch.cuda says of the device."""
    about = SimpleNamespace(
        name="pretended", major=9, minor=0, total_memory=80 << 30, multi_processor_count=132, shared_memory_per_block_optin=232448
    )

    def synchronize(device: Any = None) -> None:
        syncs.note("synchronize")

    return {
        "_lazy_init": lambda: None,
        "is_available": lambda: True,
        "is_initialized": lambda: True,
        "device_count": lambda: 1,
        "current_device": lambda: 0,
        "Event": Event,
        "set_device": lambda device: None,
        "get_device_capability": lambda device=None: (9, 0),
        "get_device_name": lambda device=None: about.name,
        "get_device_properties": lambda device=None: about,
        "current_stream": lambda device=None: SimpleNamespace(cuda_stream=0, synchronize=synchronize),
        "is_current_stream_capturing": lambda: False,
        "synchronize": synchronize,
        "mem_get_info": lambda device=None: (60 << 30, 80 << 30),
        **dict.fromkeys(("memory_allocated", "max_memory_allocated", "memory_reserved", "max_memory_reserved"), lambda device=None: 0),
        **dict.fromkeys(("reset_peak_memory_stats", "empty_cache", "manual_seed_all", "manual_seed"), lambda *given: None),
    }
