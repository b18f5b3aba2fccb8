"""What is in benchmarks/ can be imported, and runs on one thread: for these small tensors several would only wait for one another."""

import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
sys.path.append(str(BENCHMARKS))


@pytest.fixture(autouse=True)
def _always(one_thread):
    pass
