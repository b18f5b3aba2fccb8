"""A process that ends with the one that started it, also where that one was killed and could tell nobody.

``python -m e4dgs.workflows.machine.orphan PID MODULE`` runs a module that ends with process PID: for programs that do not look themselves.
"""

from __future__ import annotations

import os
import runpy
import signal
import sys
import threading
import time
from collections.abc import Callable

STARTER = "E4DGS_STARTER"  # in the environment: the process to end with
LOOK = 0.5  # s between two looks at who the parent is
GRACE = 10.0  # s between the request to end and the end


def end_with_starter() -> None:
    """From now on this process ends with the one that its environment names, if it names one: as Ctrl-C would end it, and after `GRACE` at
    once. What a leader of a group has started goes with it."""
    starter = os.environ.pop(STARTER, "")  # not for processes that this one starts
    if starter:
        _when_gone(int(starter), _end)


def _when_gone(parent: int, act: Callable[[], None]) -> None:
    def look() -> None:
        while os.getppid() == parent:
            time.sleep(LOOK)
        act()

    threading.Thread(target=look, name="starter", daemon=True).start()


def _end() -> None:
    leads = os.getpgrp() == os.getpid()  # as stages of a batch do; else others belong to the group
    for number in (signal.SIGTERM, signal.SIGKILL):
        if leads:
            os.killpg(0, number)
        else:
            os.kill(os.getpid(), number)
        time.sleep(GRACE)


if __name__ == "__main__":
    _when_gone(int(sys.argv[1]), lambda: os._exit(1))
    runpy.run_module(sys.argv[2], run_name="__main__", alter_sys=True)
