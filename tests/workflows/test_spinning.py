"""Threads of a run give a core that another program wants away soon."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="GNU OpenMP")


def said(**environment: str) -> str:
    """What GNU OpenMP says of its settings when PyTorch brings it into a process of the command line."""
    code = "from e4dgs.workflows.cli import main; main(['--version']); import torch"
    kept = {name: value for name, value in os.environ.items() if name not in ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY")}
    done = subprocess.run(
        [sys.executable, "-c", code], env=kept | {"OMP_DISPLAY_ENV": "verbose"} | environment, capture_output=True, text=True, check=True
    )
    return done.stderr


def test_threads_wait_briefly():
    assert "GOMP_SPINCOUNT = '5000'" in said()


def test_what_the_user_has_set_stays():
    assert "GOMP_SPINCOUNT = '77'" in said(GOMP_SPINCOUNT="77")
    assert "GOMP_SPINCOUNT = '0'" in said(OMP_WAIT_POLICY="passive")
