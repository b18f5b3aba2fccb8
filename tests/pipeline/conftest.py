"""A tiny workflow of four stages on a text file with numbers; see toy_stages.py."""

import os
import sys
import tempfile
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent))  # for toy_stages, which subprocesses import too

import toy_stages


@pytest.fixture
def bench(tmp_path: Path) -> toy_stages.Bench:
    """A capture with the numbers 1 2 3 and an empty workspace."""
    return toy_stages.Bench.create(tmp_path)


@pytest.fixture
def quick_folder(tmp_path: Path):
    """An empty folder in memory where there is one: for tests that sync hundreds of times, and are not about the disk."""
    if not os.access("/dev/shm", os.W_OK):
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        yield Path(folder)
