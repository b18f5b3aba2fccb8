"""Fixtures of the rasterizer's tests: one thread unless a test sets its own, and each instruction set in turn. And what puts the CUDA
kernels where the CPU's are."""

from collections.abc import Iterator

import pytest
import torch
from e4dgs.rasterizer import cpu_backend, cuda_backend
from rasterizer.conftest import _always, instruction_set  # noqa: F401
from rasterizer.kernels import EMULATED, GPU, ready


@pytest.fixture(autouse=True)
def kernels_under_stress(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """With --kernels=cuda, what the tests ask of the CPU kernels is asked of the CUDA ones, with sums in a fixed order."""
    if request.config.getoption("--kernels") == "cpu":
        yield
        return
    with ready(GPU if torch.cuda.is_available() else EMULATED):
        monkeypatch.setattr(cpu_backend, "rasterize_cpu", lambda *scene: cuda_backend.rasterize_cuda(*scene))
        before = torch.are_deterministic_algorithms_enabled()
        torch.use_deterministic_algorithms(True)
        yield
        torch.use_deterministic_algorithms(before)
