"""Runs the viewer in a separate process beside a run."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

from ..machine.orphan import STARTER
from ..results import words_of
from ..session import Options

LEFT_TO_END = 10.0  # s


@contextmanager
def viewer_beside(options: Options) -> Iterator[None]:
    """Opens `e4dgs view` for the capture as soon as there is a checkpoint. After the block, waits for Ctrl-C or the viewer's end.

    The viewer ends with this process, even if this process is killed.
    """
    given = replace(options, choice=replace(options.choice, resolved=()), store_also=())
    command = [sys.executable, "-m", "e4dgs.workflows.cli", "view", *words_of(given), "--wait"]
    command += ["--preset", "default"] if options.choice.preset == "default" else []  # without options it would show the last run
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, env=dict(os.environ) | {STARTER: str(os.getpid())})
    try:
        yield
        with suppress(KeyboardInterrupt):
            process.wait()
    finally:
        process.terminate()
        try:
            process.wait(timeout=LEFT_TO_END)
        except subprocess.TimeoutExpired:  # on a very busy machine; no viewer may be left behind
            process.kill()
            process.wait()
