"""Runs a stage in its own process, ends it if it takes too long or too much memory, and explains failures."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import psutil

from ...pipeline.machine.memory import memory_of_children

LAST_LINES = 3  # of a stage's log that go into the message about its failure
LOOK = 0.2  # s between two checks of the time
LOOK_AT_MEMORY = 1.0  # s between two checks of memory, since listing children walks the process table
GRACE = 10.0  # s between SIGTERM and SIGKILL


class Process(Protocol):
    """The leader of a process group: a `subprocess.Popen` with its own session, or a `forks.Fork`."""

    @property
    def pid(self) -> int: ...
    def poll(self) -> int | None: ...
    def wait(self, timeout: float | None = None) -> int: ...


@dataclass(frozen=True)
class Ended:
    """code: exit code, negative for a signal; None if we ended it. problem: why it failed, "" if it did not. memory: whether it failed for
    lack of memory."""

    code: int | None
    seconds: float
    problem: str = ""
    memory: bool = False


def run_process(
    start: Callable[[], Process], log: Path, timeout: float | None, too_large: Callable[[float], str], stopped: Callable[[], bool]
) -> Ended:
    """Starts a process with ``start`` and waits for it. The process appends its output to ``log``.

    timeout: seconds. too_large: called once a second with the GB that the process and its children use; if it returns a text, the process
    is ended with that text as the problem. stopped: polled; True ends the process.
    """
    started = time.monotonic()
    begin = log.stat().st_size if log.is_file() else 0
    process = start()
    try:
        code, problem, memory = _wait(process, started, timeout, too_large, stopped)
    finally:
        _end(process)
    seconds = time.monotonic() - started
    if code is None:
        return Ended(None, seconds, problem, memory)
    return Ended(code, seconds, _why(log, begin, code) if code else "", memory=code == -signal.SIGKILL)


def _wait(
    process: Process, started: float, timeout: float | None, too_large: Callable[[float], str], stopped: Callable[[], bool]
) -> tuple[int | None, str, bool]:
    """Exit code, or None and why the process must be ended; and whether that is for its memory."""
    looked = started
    while not stopped():
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.wait(LOOK), "", False
        now = time.monotonic()
        if timeout is not None and now - started > timeout:
            return None, f"ended after {timeout:.0f} s (--stage-timeout); what it has done so far is kept", False
        if now - looked > LOOK_AT_MEMORY:
            looked = now
            if problem := too_large(_memory_gb(process.pid)):
                return None, problem, True
    return None, "", False


def _memory_gb(pid: int) -> float:
    """Resident memory of a process and its children, GB."""
    with contextlib.suppress(psutil.Error):
        process = psutil.Process(pid)
        return (process.memory_info().rss + memory_of_children(process)) / 1e9
    return 0.0


def _end(process: Process) -> None:
    """Ends the process and its group, which includes what it has started."""
    if process.poll() is None:
        _signal(process, signal.SIGTERM)
        try:
            process.wait(GRACE)
        except subprocess.TimeoutExpired:
            _signal(process, signal.SIGKILL)
            process.wait()


def _signal(process: Process, number: signal.Signals) -> None:
    """Sends a signal to the group, unless it has just ended: the server of a `forks.Fork` takes notice of that before we do."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, number)


def _why(log: Path, begin: int, code: int) -> str:
    """The last words of a failed process. begin: where its part of the log begins, bytes."""
    if code < 0:
        number = -code
        hint = "; out of memory, perhaps: fewer scenes at a time (--jobs) or smaller pictures" if number == signal.SIGKILL else ""
        return f"ended by {signal.Signals(number).name}{hint}; see {log}"
    with open(log, "rb") as file:
        file.seek(begin)
        lines = file.read().decode(errors="replace").strip().splitlines()
    errors = [line for line in lines if line.startswith("error: ")]
    return errors[-1].removeprefix("error: ") if errors else " | ".join(lines[-LAST_LINES:])
