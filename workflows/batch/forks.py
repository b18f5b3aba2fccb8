"""Runs stages as forks of processes that have already imported what stages need (`fork_server.py`)."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path


class Fork:
    """A stage's process, with the part of `subprocess.Popen`'s interface that `process.py` needs."""

    def __init__(self, servers: ForkServers, server: _Server, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None
        self._servers, self._server = servers, server

    def poll(self) -> int | None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.wait(0.0)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Exit code, negative for a signal. Raises subprocess.TimeoutExpired after ``timeout`` seconds."""
        if self.returncode is None:
            code = self._server.answer(timeout)
            if code is None:  # the server is gone, and the stage would end itself a little later
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(self.pid, signal.SIGKILL)
                self._server.close()
                code = -signal.SIGKILL
            else:
                self._servers.give_back(self._server)
            self.returncode = code
        return self.returncode


class ForkServers:
    """Keeps one server for each stage that runs at the same time. Idle servers keep their imports and wait for the next stage."""

    def __init__(self) -> None:
        self._idle: list[_Server] = []
        self._lock = threading.Lock()

    def fork(self, arguments: Sequence[str], environment: Mapping[str, str], log: Path) -> Fork:
        """Runs e4dgs with ``arguments``; its output is appended to ``log``.

        Libraries read thread counts from the environment when they are imported, so each server serves one environment. Raises OSError
        if no server could be started; ``log`` says why.
        """
        while (server := self._take(environment)) is not None:
            with contextlib.suppress(OSError):  # it died while idle
                return Fork(self, server, server.ask(arguments, log))
            server.close()
        server = _Server(environment, log)
        try:
            return Fork(self, server, server.ask(arguments, log))
        except OSError:
            server.close()
            raise

    def close(self) -> None:
        """Ends the idle servers."""
        with self._lock:
            idle, self._idle = self._idle, []
        for server in idle:
            server.close()

    def give_back(self, server: _Server) -> None:
        with self._lock:
            self._idle.append(server)

    def _take(self, environment: Mapping[str, str]) -> _Server | None:
        """An idle server for ``environment``. Servers for other environments are closed, since thread counts change as scenes finish."""
        with self._lock:
            others = [server for server in self._idle if server.environment != environment]
            self._idle = [server for server in self._idle if server.environment == environment]
            found = self._idle.pop() if self._idle else None
        for server in others:
            server.close()
        return found


class _Server:
    def __init__(self, environment: Mapping[str, str], log: Path) -> None:
        self.environment = dict(environment)
        command = [sys.executable, "-m", "e4dgs.workflows.batch.fork_server"]
        with open(log, "ab") as errors:
            self._process = subprocess.Popen(
                command,
                bufsize=0,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                env=self.environment,
                start_new_session=True,
            )

    def ask(self, arguments: Sequence[str], log: Path) -> int:
        """Starts a stage and returns its process id. Raises OSError."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it has ended and will not answer
            self._process.stdin.write(json.dumps([list(arguments), str(log)]).encode() + b"\n")
        pid = self.answer(None)
        if pid is None:
            raise OSError(f"the process that starts stages has ended; see {log}")
        return pid

    def answer(self, timeout: float | None) -> int | None:
        """The server's next answer, a number; None if the server has ended. Raises subprocess.TimeoutExpired."""
        assert self._process.stdout is not None
        poll = select.poll()
        poll.register(self._process.stdout, select.POLLIN)
        until = None if timeout is None else time.monotonic() + timeout
        if not poll.poll(None if until is None else 1000 * max(0.0, until - time.monotonic())):
            raise subprocess.TimeoutExpired("fork_server", timeout or 0.0)
        line = self._process.stdout.readline()
        return int(line) if line.endswith(b"\n") else None

    def close(self) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        self._process.stdout.close()
        self._process.wait()
