"""Makes a process end together with the one that started it, even if that one was killed without warning.

``python -m e4dgs.workflows.machine.orphan PID MODULE`` runs a module that ends with process PID, for programs without such a check.
"""

from __future__ import annotations

import os
import runpy
import signal
import sys
import threading
import time
from collections.abc import Callable

STARTER = "E4DGS_STARTER"  # environment variable: id of the process to end with
LOOK = 0.5  # s between two checks of the parent's id
GRACE = 10.0  # s between SIGTERM and SIGKILL


def end_with_starter() -> None:
    """From now on, ends this process with the one that its environment names, if any: first as Ctrl-C would, after `GRACE` by force. The
    leader of a process group also ends what it has started."""
    starter = os.environ.pop(STARTER, "")  # removed, so that child processes do not inherit it
    if starter:
        _when_gone(int(starter), _end)


def _when_gone(parent: int, act: Callable[[], None]) -> None:
    def look() -> None:
        while os.getppid() == parent:
            time.sleep(LOOK)
        act()

    threading.Thread(target=look, name="starter", daemon=True).start()


def _end() -> None:
    leads = os.getpgrp() == os.getpid()  # as stages of a batch do; otherwise the group has other members
    for number in (signal.SIGTERM, signal.SIGKILL):
        if leads:
            os.killpg(0, number)
        else:
            os.kill(os.getpid(), number)
        time.sleep(GRACE)


if __name__ == "__main__":
    _when_gone(int(sys.argv[1]), lambda: os._exit(1))
    runpy.run_module(sys.argv[2], run_name="__main__", alter_sys=True)
