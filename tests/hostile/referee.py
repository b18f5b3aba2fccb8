"""The rules for a capture that nobody should give: it is accepted or refused with one line, within bounds, and nothing else changes."""

from __future__ import annotations

import contextlib
import functools
import io
import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from unittest import mock

import typer

SECONDS = 10.0  # of CPU, which a busy machine does not change
LONGEST = 1400  # characters of what is said


class BrokenRule(Exception):
    """What the command did that it must not do."""


def examine(
    sandbox: Path,
    capture: Path,
    options: tuple[str, ...] = (),
    command: Callable[[list[str]], int] | None = None,
    names: tuple[str, ...] = (),
) -> str:
    """`e4dgs plan` of ``capture``, which lies in ``sandbox``, and `e4dgs run frames` where that accepts it: "accepted", or the message of
    the refusal. Raises BrokenRule. command: stands for e4dgs. names: what a refusal has to say."""
    command = command or _e4dgs
    workspace = sandbox / "workspace"
    before = _listing(sandbox)
    words = [str(capture), "--workspace", str(workspace), "--device", "cpu", *options]
    message = _run(command, ["plan", *words])
    if not message:
        message = _run(command, ["run", "frames", *words])
    changed = sorted(before ^ _listing(sandbox))
    if changed:
        raise BrokenRule(f"changed outside of the workspace: {changed[0][0]}")
    _no_parts(workspace)
    missing = [name for name in names if name not in message] if message else []
    if missing:
        raise BrokenRule(f"{missing[0]!r} is not named in: {message}")
    return message or "accepted"


@functools.cache
def _parser() -> Callable[..., int]:
    """The parser of the command line; typer would build it anew for each command, in four fifths of a short one's time."""
    from e4dgs.workflows.cli import app

    return typer.main.get_command(app)


def _e4dgs(words: list[str]) -> int:
    from e4dgs.workflows import cli

    with mock.patch.object(cli, "app", _parser()):
        return cli.main(words)


def _run(command: Callable[[list[str]], int], words: list[str]) -> str:
    """The message of a refusal, empty where the command did what it was told."""
    out, err = io.StringIO(), io.StringIO()
    started = time.process_time()
    with contextlib.redirect_stdout(_Strict(out)), contextlib.redirect_stderr(_Strict(err)), at_most(SECONDS):
        code = command(words)
    took = time.process_time() - started
    said = err.getvalue().strip()
    if took > SECONDS:
        raise BrokenRule(f"{words[0]} took {took:.0f} s")
    if code == 0:
        return ""
    if code != 2:
        raise BrokenRule(f"{words[0]} ended with {code}: {said[-600:]}")
    if "\n" in said or not said.startswith("error: ") or "Traceback" in said or len(said) > LONGEST:
        raise BrokenRule(f"{words[0]} said no single line: {said[:600]!r}")
    if any(ord(c) < 32 or 0x7F <= ord(c) < 0xA0 for c in said):
        raise BrokenRule(f"control characters in: {said!r}")
    return said


class _Strict(io.TextIOBase):
    """Takes what a terminal of UTF-8 can take, as the real ones do."""

    def __init__(self, target: io.StringIO) -> None:
        self.target = target

    def write(self, text: str) -> int:
        text.encode()
        return self.target.write(text)


@contextlib.contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Ends what takes longer than so many seconds of CPU, where Python gets a word in."""

    def stop(number: int, frame: object) -> None:
        raise BrokenRule(f"more than {seconds:g} s of CPU")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def _listing(sandbox: Path) -> set[tuple[str, int, int, int]]:
    """Path, kind, size and time of change of all that is in the sandbox but for the workspace."""
    found = set()
    for folder, folders, files in os.walk(sandbox):
        if folder == str(sandbox) and "workspace" in folders:
            folders.remove("workspace")
        for name in (*folders, *files):
            path = os.path.join(folder, name)
            state = os.lstat(path)
            found.add((path.encode("utf-8", "surrogateescape").decode("latin-1"), state.st_mode, state.st_size, state.st_mtime_ns))
    return found


def _no_parts(workspace: Path) -> None:
    """Results are whole, and nothing temporary is left."""
    store = workspace / "store"
    for stage in store.iterdir() if store.is_dir() else ():
        left = list(stage.iterdir()) if stage.is_dir() else []
        if stage.name in ("tmp", "quarantine"):
            if left:
                raise BrokenRule(f"left behind: {left[0].relative_to(workspace)}")
        elif stage.name not in ("locks", "checkpoints"):
            for result in left:
                if not (result / "manifest.json").is_file():
                    raise BrokenRule(f"no whole result: {result.relative_to(workspace)}")
    unpacked = workspace / "unpacked"
    hidden = [path for path in unpacked.iterdir() if path.name.startswith(".")] if unpacked.is_dir() else []
    if hidden:
        raise BrokenRule(f"left behind: {hidden[0].relative_to(workspace)}")
