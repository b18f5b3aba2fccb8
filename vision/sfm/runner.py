"""`run_worker`: runs one COLMAP task in a subprocess, so that a crash in native code becomes one clear error and nothing leaks."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from . import worker

Progress = Callable[[str, int, int], None]  # phase ("features", "matches", "mapping", "points"), done, total

LOG_LINES = 12  # from the end of COLMAP's log that go into an error


class WorkerError(RuntimeError):
    """The worker ended without a result. The message says how it ended and quotes the end of its log."""


def run_worker(request: Mapping[str, Any], folder: Path, progress: Progress | None = None) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Runs `request` (JSON, with `task`); `folder` holds its database, log and results. Returns the arrays and facts of the task.

    The parent never imports pycolmap. Raises WorkerError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("result.json", "result.npz"):
        (folder / name).unlink(missing_ok=True)
    file, log = folder / "request.json", folder / "colmap.log"
    file.write_text(json.dumps(_document(request, folder)), encoding="utf-8")
    command = [sys.executable, "-m", worker.__name__, str(file)]
    # the worker has its own threads; BLAS threads on top of them would spin and cost four times the processor time
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    with log.open("wb") as stderr:
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=stderr, text=True, errors="replace", env=environment
        )
        try:
            assert process.stdout is not None
            for line in process.stdout:
                step = _step(line)
                if step is not None and progress is not None:
                    progress(*step)
            code = process.wait()
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    pipe.close()
    if code != 0 or not (folder / "result.json").is_file():
        raise WorkerError(_story(code, log))
    return _result(folder)


def finished(request: Mapping[str, Any], folder: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]] | None:
    """The result of an earlier `run_worker` with the same request and folder, for a program that was killed since; None if unfinished."""
    try:
        same = json.loads((folder / "request.json").read_text(encoding="utf-8")) == _document(request, folder)
        return _result(folder) if same else None
    except (OSError, ValueError):  # missing or cut short
        return None


def _document(request: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The request as the worker reads it. It goes through JSON and back, so that tuples compare equal to lists."""
    document: dict[str, Any] = json.loads(json.dumps({**request, "folder": str(folder)}))
    return document


def _result(folder: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    facts = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    with np.load(folder / "result.npz", allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}, facts


def _step(line: str) -> tuple[str, int, int] | None:
    """Parses a line of progress; None for anything that a library printed."""
    try:
        step = json.loads(line)
        return str(step["phase"]), int(step["done"]), int(step["total"])
    except (ValueError, KeyError, TypeError):
        return None


def _story(code: int, log: Path) -> str:
    if code < 0:
        try:
            how = f"was ended by {signal.Signals(-code).name}" + (" (out of memory?)" if -code == signal.SIGKILL else "")
        except ValueError:
            how = f"was ended by signal {-code}"
    else:
        how = f"ended with exit code {code}"
    tail = log.read_text(encoding="utf-8", errors="replace").splitlines()[-LOG_LINES:]
    return f"COLMAP {how}. The end of {log}:\n  " + "\n  ".join(tail or ["(empty)"])
