"""A process that forks itself for each stage: ``python -m e4dgs.workflows.batch.fork_server``, started by `forks.py`.

A new Python takes 2 to 3 s of a core to import what a stage needs. A fork has it from the start, and is as much a process of its own: it
may crash, hang or run out of memory alone. What a stage had to import, the server imports after it, for the stages that follow.

Reads a line of JSON for each stage, ``[arguments of e4dgs, path of the log]``, and answers with two: process id, and exit code (negative
for a signal). One stage at a time. It ends, and ends its stage, when its standard input ends. It also ends when source of ours that it has
imported was edited: a fork would compute with the old code and take its result for the new one's.
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

GPU = "/dev/nvidia"  # how the names of its devices begin
FIRST_TO_GO = "500"  # of 1000: where the system runs out of memory it ends a stage, and not who looks after the stages


def serve() -> int:
    os.environ[STARTER] = str(os.getpid())  # stages end with this process
    answers = os.dup(1)
    os.dup2(2, 1)  # what an import prints is no answer
    imported = _sources()
    while line := sys.stdin.buffer.readline():
        if any(_digest(file) != digest for file, digest in imported.items()):
            break  # without an answer: who asks starts another server
        arguments, log = json.loads(line)
        reading, writing = os.pipe()
        gc.freeze()  # what the fork's garbage collector looks at it would have to copy
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
    except OSError:  # it has gone
        return ""


def _stage(arguments: list[str], log: str, writing: int) -> NoReturn:
    """In the fork. Its end closes ``writing``, into which goes first what the next stages may want imported."""
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
    with contextlib.suppress(OSError), open(writing, "w") as report:  # the server may be gone
        report.write("\n".join(new))
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # the usual end takes every module apart, and for that copies what was shared: 0.7 s


def _uses_gpu() -> bool:
    """A process that has opened a GPU cannot be forked, so nothing is learned from a stage that has: what it imports may open one."""
    for number in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError):
            if os.readlink(f"/proc/self/fd/{number}").startswith(GPU):
                return True
    return False


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
