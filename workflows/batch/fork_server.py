"""A process that forks itself for each stage: ``python -m e4dgs.workflows.batch.fork_server``, started by `forks.py`.

A new Python needs 2 to 3 s of CPU time to import what a stage needs. A fork has it from the start, and can still crash, hang or run out
of memory alone. After a stage, the server imports what that stage had to import.

It reads a line of JSON for each stage, ``[arguments of e4dgs, path of the log]``, and answers with two lines: process id, and exit code
(negative for a signal). When its standard input ends, it ends its stage and itself. It also ends when a source file of ours that it has
imported was edited: a fork would store what the old code computes under the new code's key.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import importlib
import json
import os
import select
import shlex
import signal
import sys
import time
from pathlib import Path
from typing import NoReturn

from setproctitle import setproctitle

from ...pipeline.files import digest_file
from ..machine.orphan import STARTER
from .process import GRACE

GPU = "/dev/nvidia"  # prefix of the device files
FIRST_TO_GO = "500"  # of 1000: if the system runs out of memory, it should end a stage and not the process that manages stages


def serve() -> int:
    os.environ[STARTER] = str(os.getpid())  # stages end with this process
    answers = os.dup(1)
    os.dup2(2, 1)  # output printed by imports must not mix with answers
    imported = _sources()
    while line := sys.stdin.buffer.readline():
        if any(_digest(file) != digest for file, digest in imported.items()):
            break  # without an answer, so the caller starts another server
        arguments, log = json.loads(line)
        reading, writing = os.pipe()
        gc.freeze()  # pages that the fork's garbage collector touches would have to be copied
        pid = os.fork()
        if pid == 0:
            os.close(answers)
            os.close(reading)
            _stage(arguments, log, writing)
        os.close(writing)
        _lead_group(pid)
        os.write(answers, b"%d\n" % pid)
        names = _until_ended(reading, pid)
        os.close(reading)
        _, status = os.waitpid(pid, 0)
        os.write(answers, b"%d\n" % os.waitstatus_to_exitcode(status))
        for name in names:
            with contextlib.suppress(Exception):  # some names in sys.modules cannot be imported, and need not be
                importlib.import_module(name)
        imported = _sources() | imported
    return 0


def _sources() -> dict[str, str]:
    """Path -> digest of each source file of this package that has been imported."""
    ours = f"{__package__.partition('.')[0]}."
    files = {getattr(module, "__file__", None) for name, module in list(sys.modules.items()) if f"{name}.".startswith(ours)}
    return {file: _digest(file) for file in files if file is not None}


def _digest(file: str) -> str:
    try:
        return digest_file(Path(file))
    except OSError:  # it was removed
        return ""


def _stage(arguments: list[str], log: str, writing: int) -> NoReturn:
    """Runs a stage, in the fork. At its end it writes the names of new modules to ``writing``, for the server to import, and closes it."""
    _lead_group(0)
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w") as file:  # not Linux
        file.write(FIRST_TO_GO)
    output = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
    nothing = os.open(os.devnull, os.O_RDONLY)
    for source, target in ((nothing, 0), (output, 1), (output, 2)):
        os.dup2(source, target)
    os.close(output)
    os.close(nothing)
    setproctitle(shlex.join(["e4dgs", *arguments]))
    sys.argv = ["e4dgs", *arguments]
    before = set(sys.modules)
    from ..cli import main

    code = int(main(arguments) or 0)
    new = [] if _uses_gpu() else sorted(set(sys.modules) - before)
    with contextlib.suppress(OSError), open(writing, "w") as report:  # the server may have ended
        report.write("\n".join(new))
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # a normal exit would tear down every module and copy shared pages for that: 0.7 s


def _uses_gpu() -> bool:
    """Whether this process has opened a GPU. The server must never do so, since it could then not fork; so it imports nothing that such a
    stage imported, because importing that may open a GPU."""
    for number in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError):
            if os.readlink(f"/proc/self/fd/{number}").startswith(GPU):
                return True
    return False


def _until_ended(reading: int, pid: int) -> list[str]:
    """Waits until the stage has ended and returns what it reports. If the process that started this one is gone, ends the stage and this
    process."""
    found = b""
    while True:
        ready, _, _ = select.select([0, reading], [], [])
        if reading in ready:
            more = os.read(reading, 1 << 16)
            if not more:
                return found.decode(errors="replace").split()
            found += more
        elif 0 in ready:  # stages are requested one at a time, so this is the end of the input
            _end(reading, pid)
            os._exit(1)


def _end(reading: int, pid: int) -> None:
    """Ends the stage and what it has started."""
    until = time.monotonic() + GRACE
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGTERM)
        while time.monotonic() < until and select.select([reading], [], [], max(0.0, until - time.monotonic()))[0]:
            if not os.read(reading, 1 << 16):
                break
        os.killpg(pid, signal.SIGKILL)


def _lead_group(pid: int) -> None:
    """Makes a process the leader of its group. The fork and its parent both do this, so that the group exists for either from the start."""
    with contextlib.suppress(OSError):
        os.setpgid(pid, pid)


if __name__ == "__main__":
    sys.exit(serve())
