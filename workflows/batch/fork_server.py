"""A process that forks itself for each stage: ``python -m e4dgs.workflows.batch.fork_server``, started by `forks.py`.

A new Python takes 2 to 3 s of a core to import what a stage needs. A fork has it from the start, and is as much a process of its own: it
may crash, hang or run out of memory alone. What a stage had to import, the server imports after it, for the stages that follow.

Reads a line of JSON for each stage, ``[arguments of e4dgs, path of the log]``, and answers with two: process id, and exit code (negative for
a signal). One stage at a time. It ends, and ends its stage, when its standard input ends.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import select
import shlex
import signal
import sys
import time

from setproctitle import setproctitle

from ..orphan import STARTER
from .process import GRACE

FIRST_TO_GO = "500"  # of 1000: where the system runs out of memory it ends a stage, and not who looks after the stages


def serve() -> int:
    os.environ[STARTER] = str(os.getpid())  # stages end with this process
    answers = os.dup(1)
    os.dup2(2, 1)  # what an import prints is no answer
    while line := sys.stdin.buffer.readline():
        arguments, log = json.loads(line)
        reading, writing = os.pipe()
        pid = os.fork()
        if pid == 0:
            os.close(answers)
            os.close(reading)
            return _stage(arguments, log, writing)
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
    return 0


def _stage(arguments: list[str], log: str, writing: int) -> int:
    """In the fork. Its end closes ``writing``, into which goes first what the next stages may want imported."""
    _lead_group(0)
    with contextlib.suppress(OSError):  # not Linux
        with open("/proc/self/oom_score_adj", "w") as file:
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
    new = sorted(set(sys.modules) - before)
    with contextlib.suppress(OSError), open(writing, "w") as report:  # the server may be gone
        report.write("\n".join([] if _used_gpu(new) else new))
    return code


def _used_gpu(new: list[str]) -> bool:
    """A process that has opened a GPU cannot be forked, so nothing is learned from stages that use one."""
    torch = sys.modules.get("torch")
    return any(name.partition(".")[0] == "cuda" for name in new) or (torch is not None and torch.cuda.is_initialized())


def _until_ended(reading: int, pid: int) -> list[str]:
    """What the stage reports, when it has ended. Ends it, and this process, where who started this process is gone."""
    found = b""
    while True:
        ready, _, _ = select.select([0, reading], [], [])
        if reading in ready:
            more = os.read(reading, 1 << 16)
            if not more:
                return found.decode(errors="replace").split()
            found += more
        elif 0 in ready:  # only one stage is asked for at a time, so this is the end of the input
            _end(reading, pid)
            os._exit(1)


def _end(reading: int, pid: int) -> None:
    """The stage, and what it has started."""
    until = time.monotonic() + GRACE
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGTERM)
        while time.monotonic() < until and select.select([reading], [], [], max(0.0, until - time.monotonic()))[0]:
            if not os.read(reading, 1 << 16):
                break
        os.killpg(pid, signal.SIGKILL)


def _lead_group(pid: int) -> None:
    """Done by the fork and by its parent, so that the group is there for both at once."""
    with contextlib.suppress(OSError):
        os.setpgid(pid, pid)


if __name__ == "__main__":
    sys.exit(serve())
