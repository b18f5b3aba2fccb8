"""Stages are forks of a process that has imported what they need."""

import os
import signal
import subprocess
import time
from pathlib import Path

import psutil
import pytest
from e4dgs.workflows.batch.forks import Fork, ForkServers, _Server

PATIENCE = 60.0  # s

# Instead of e4dgs.workflows.cli, for every Python that has the folder first on its PYTHONPATH.
SITE = """
import importlib.util, pathlib, sys
class Finder:
    def find_spec(name, path=None, target=None):
        if name == "e4dgs.workflows.cli":
            return importlib.util.spec_from_file_location(name, pathlib.Path(__file__).parent / "commands.py")
sys.meta_path.insert(0, Finder)
"""
COMMANDS = """
import importlib, os, signal, sys, time
def main(arguments):
    command, *rest = arguments
    if command == "import":
        print("there" if rest[0] in sys.modules else "new")
        importlib.import_module(rest[0])
        if rest[1:]:
            sys.modules["__main__"].GPU = rest[1]
            main.device = open(rest[1], "w")
    elif command == "threads":
        print(os.environ["OMP_NUM_THREADS"])
    elif command == "sleep":
        print("sleeps", flush=True)
        time.sleep(600)
    elif command == "deaf":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        print("sleeps", flush=True)
        time.sleep(600)
    elif command == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    elif command == "fail":
        return 3
"""


class Commands:
    """Runs the commands above as forks."""

    def __init__(self, folder: Path) -> None:
        (folder / "sitecustomize.py").write_text(SITE)
        (folder / "commands.py").write_text(COMMANDS)
        path = os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])
        self.environment = dict(os.environ, PYTHONPATH=path, OMP_NUM_THREADS="1")
        self.log, self.servers = folder / "log.txt", ForkServers()

    def start(self, *arguments: str, **environment: str) -> Fork:
        return self.servers.fork(arguments, self.environment | environment, self.log)

    def says(self, *arguments: str, **environment: str) -> str:
        self.log.write_text("")
        assert self.start(*arguments, **environment).wait(PATIENCE) == 0, self.log.read_text()
        return self.log.read_text().strip()

    def sleeps(self, command: str = "sleep") -> Fork:
        self.log.write_text("")
        fork = self.start(command)
        until = time.monotonic() + PATIENCE
        while "sleeps" not in self.log.read_text():
            assert time.monotonic() < until
            time.sleep(0.02)
        return fork


@pytest.fixture
def commands(tmp_path):
    made = Commands(tmp_path)
    yield made
    made.servers.close()


def server_of(fork: Fork) -> psutil.Process:
    return psutil.Process(fork.pid).parent()


def wait_until_gone(pid: int) -> None:
    until = time.monotonic() + PATIENCE
    while psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < until
        time.sleep(0.02)


def test_what_a_stage_imports_is_there_for_the_next_one(commands):
    assert [commands.says("import", "colorsys") for _ in range(2)] == ["new", "there"]


def test_what_has_opened_a_gpu_teaches_nothing(commands, tmp_path):
    device = str(tmp_path / "nvidia0")
    assert [commands.says("import", "colorsys", device) for _ in range(2)] == ["new", "new"]


def test_a_server_that_has_imported_code_which_was_edited_is_replaced(commands, tmp_path):
    """Its forks would compute with the old code under the key of the new one."""
    assert [commands.says("import", "colorsys") for _ in range(2)] == ["new", "there"]
    (tmp_path / "commands.py").write_text(COMMANDS.replace('"there"', '"edited, and there"').replace('"new"', '"edited, and new"'))
    assert [commands.says("import", "colorsys") for _ in range(2)] == ["edited, and new", "edited, and there"]


def test_libraries_get_the_threads_that_a_stage_may_take(commands):
    assert [commands.says("threads", OMP_NUM_THREADS=number) for number in ("1", "3", "1")] == ["1", "3", "1"]


def test_exit_codes_and_signals_arrive(commands):
    assert commands.start("fail").wait(PATIENCE) == 3
    assert commands.start("crash").wait(PATIENCE) == -signal.SIGSEGV
    assert commands.says("import", "colorsys") == "new", "the server goes on"


def test_a_stage_has_a_name_and_a_group_of_its_own(commands):
    fork = commands.sleeps()
    assert " ".join(psutil.Process(fork.pid).cmdline()).split() == ["e4dgs", "sleep"]
    assert os.getpgid(fork.pid) == fork.pid != os.getpgid(server_of(fork).pid)
    assert fork.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        fork.wait(0.05)
    os.killpg(fork.pid, signal.SIGTERM)
    assert fork.wait(PATIENCE) == fork.poll() == -signal.SIGTERM


def test_a_server_that_dies_takes_its_stage_along(commands):
    fork = commands.sleeps("deaf")
    server_of(fork).kill()
    assert fork.wait(PATIENCE) == -signal.SIGKILL
    wait_until_gone(fork.pid)
    assert commands.says("import", "colorsys") == "new", "another server takes its place"


def test_a_server_that_died_while_it_waited_is_replaced(commands):
    fork = commands.sleeps()
    server = server_of(fork)
    os.killpg(fork.pid, signal.SIGKILL)
    fork.wait(PATIENCE)
    server.kill()
    assert commands.says("import", "colorsys") == "new"


@pytest.mark.parametrize("later", [False, True])
def test_a_server_that_cannot_start_leaves_its_words_in_the_log(commands, monkeypatch, tmp_path, later):
    broken = tmp_path / "python"
    broken.write_text("#!/bin/sh\necho no such library >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setattr("e4dgs.workflows.batch.forks.sys.executable", str(broken))
    ask = _Server.ask
    if later:  # when it is asked it has ended already
        monkeypatch.setattr(_Server, "ask", lambda self, *words: self._process.wait(PATIENCE) and ask(self, *words))
    with pytest.raises(OSError, match="has ended; see") as error:
        commands.start("fail")
    assert str(commands.log) in str(error.value) and "no such library" in commands.log.read_text()


def test_a_server_whose_starter_has_gone_ends_its_stage(commands, monkeypatch):
    fork = commands.sleeps()
    server = server_of(fork)
    fork._server._process.stdin.close()  # as the system does for a process that is killed
    wait_until_gone(fork.pid)
    wait_until_gone(server.pid)
