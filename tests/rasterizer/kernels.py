"""Whether the kernels can be used here: the CPU's with each instruction set in turn, the CUDA ones on a GPU or emulated.

Tests keep their tensors on the CPU. Emulated, backend "cuda" takes them as they are; on a GPU, `on_the_gpu` brings them there and the
frame back, so that one test says the same of all kernels.
"""

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import fields, replace
from typing import Any

import pytest
import torch
from e4dgs.rasterizer import Frame
from e4dgs.rasterizer.cuda.runtime import launching
from simt.compiler import needs_compiler
from simt.emulator import Emulator

try:
    import e4dgs.rasterizer.cpu_backend as _cpu  # noqa: F401

    missing = ""
except ImportError as cause:
    missing = f"the CPU kernels cannot be imported: {cause}"

needs_cpu = pytest.mark.skipif(bool(missing), reason=missing)


@pytest.fixture(params=["avx512", "avx2", "baseline"])
def instruction_set(request: pytest.FixtureRequest) -> Iterator[str]:
    """The kernels of this instruction set are in use."""
    from e4dgs.rasterizer import _cpu

    best = _cpu.kernels()
    if not _cpu.select_kernels(request.param):
        pytest.skip(f"this processor or build has no {request.param}")
    yield request.param
    assert _cpu.select_kernels(best)


EMULATED, GPU = "cuda emulated", "cuda"
# Fibers change stacks behind the address sanitizer's back.
not_sanitized = pytest.mark.skipif(
    "E4DGS_SANITIZED" in os.environ, reason="the emulator is not run under sanitizers, it has its own checks"
)
ALL_KERNELS = [
    pytest.param("cpu", marks=needs_cpu),
    pytest.param(EMULATED, marks=[needs_compiler, not_sanitized]),
    pytest.param(GPU, marks=pytest.mark.cuda),
]


def moved(owner: Any, device: str) -> Any:
    """A dataclass of tensors on another device, attached to the graph."""
    values = {field.name: getattr(owner, field.name) for field in fields(owner)}
    return replace(owner, **{name: value.to(device) for name, value in values.items() if isinstance(value, torch.Tensor)})


@contextmanager
def on_the_gpu() -> Iterator[None]:
    """Inside, backend "cuda" renders what lies on the CPU on the GPU."""
    from e4dgs.rasterizer import cuda_backend

    original = cuda_backend.rasterize_cuda

    def there_and_back(camera: Any, gaussians: Any, convexes: Any, background: torch.Tensor, *options: Any) -> Frame:
        frame = original(moved(camera, "cuda"), moved(gaussians, "cuda"), moved(convexes, "cuda"), background.cuda(), *options)
        return moved(frame, "cpu")

    cuda_backend.rasterize_cuda = there_and_back
    try:
        yield
    finally:
        cuda_backend.rasterize_cuda = original


def ready(name: str, seed: int = 0) -> AbstractContextManager[None]:
    """What makes the kernels of this name in ALL_KERNELS usable inside; `backend_of` is what `rasterize` is then asked for."""
    return launching("cpu", Emulator(seed)) if name == EMULATED else on_the_gpu() if name == GPU else nullcontext()


def backend_of(name: str) -> str:
    return "cuda" if name in (EMULATED, GPU) else name


@pytest.fixture(params=ALL_KERNELS)
def kernels(request: pytest.FixtureRequest) -> Iterator[str]:
    """Every kind of kernels in turn: what to ask `rasterize` for."""
    with ready(request.param):
        yield backend_of(request.param)


@pytest.fixture(params=["reference", *ALL_KERNELS])
def backend(request: pytest.FixtureRequest) -> Iterator[str]:
    """The reference and every kind of kernels in turn."""
    with ready(request.param):
        yield backend_of(request.param)
