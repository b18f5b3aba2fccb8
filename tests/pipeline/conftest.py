"""A tiny workflow of four stages on a text file with numbers; see toy_stages.py."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent))  # for toy_stages, which subprocesses import too

import toy_stages


@pytest.fixture
def bench(tmp_path: Path) -> toy_stages.Bench:
    """A capture with the numbers 1 2 3 and an empty workspace."""
    return toy_stages.Bench.create(tmp_path)
