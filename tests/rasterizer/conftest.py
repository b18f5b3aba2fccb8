"""One thread for these small tensors (several would only wait for one another); the test of thread counts sets its own. And the
fixture that puts each instruction set in turn."""

from collections.abc import Iterator

import pytest
import torch

from .kernels import backend, instruction_set, kernels  # noqa: F401


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)
