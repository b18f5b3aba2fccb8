"""One thread for these small tensors (several would only wait for one another); the test of thread counts sets its own. And the
fixture that puts each instruction set in turn."""

import pytest

from .kernels import backend, instruction_set, kernels  # noqa: F401


@pytest.fixture(autouse=True)
def _always(one_thread):
    pass
