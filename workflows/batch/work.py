"""What a worker does: the stages of a scene, each in a process of its own, so that a crash or a hang costs that stage and nothing else.

``python -m e4dgs.workflows.batch.work WORKSPACE BATCH SCENE PART`` is what a job script of a cluster calls.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ...pipeline import Job, PipelineError, make_plan
from ..reconstruction import EVALUATION, TRAINING
from ..results import words_of
from ..session import open_session
from .ledger import Ledger, Progress
from .listing import Entry

PARTS = ("before", "train", "after")  # the middle one wants the GPU
LAST_LINES = 3  # of a stage's log, for the message of its failure
LOOK = 0.2  # s between two looks at the clock
GRACE = 10.0  # s between the request to end and the end


class StageFailed(Exception):
    """A stage of a scene failed. The message says which, and why."""


def run_part(
    workspace: str,
    batch: str,
    scene: str,
    part: str,
    timeout: float | None = None,
    threads: int | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> bool:
    """Run what ``part`` of `PARTS` of a scene still needs.

    timeout: seconds for each stage. threads: for each stage. stopped: asked now and then; True ends the stage. Returns False where it was
    stopped, or the capture is refused, which another try would not change. Raises StageFailed where a stage fails; the scene's state says
    the same.
    """
    ledger = Ledger(Path(workspace), batch)
    entry = next(entry for entry in ledger.entries() if entry.name == scene)
    progress = ledger.progress(scene)
    if progress.state == "done":
        return True
    try:
        session = open_session(entry.options(Path(workspace)))
        job = session.job
        stages = _stages(job, part)
    except PipelineError as error:
        ledger.write(scene, Progress("failed", "", str(error), progress.seconds, progress.attempts + (part == "before")))
        return False
    progress.attempts += part == "before"
    for stage in stages:
        progress.state, progress.stage, progress.message = "running", EVALUATION if stage == "all" else stage, ""
        ledger.write(scene, progress)
        code, seconds = _run(ledger, entry, stage, timeout, threads, stopped)
        progress.seconds = round(progress.seconds + seconds, 1)
        if stopped():
            progress.state = "waiting"
            ledger.write(scene, progress)
            return False
        if code != 0:
            progress.state, progress.message = "failed", _why(ledger, scene, code, timeout)
            ledger.write(scene, progress)
            if code == 2:
                return False
            raise StageFailed(f"{scene}: {progress.stage}: {progress.message}")
    progress.state, progress.stage = ("done", "") if part == PARTS[-1] else ("waiting", "")
    ledger.write(scene, progress)
    return True


def is_current(ledger: Ledger, entry: Entry) -> bool:
    """Whether the store still has every result of a scene, as its capture and this version of e4dgs would make them."""
    try:
        rows = make_plan(open_session(entry.options(ledger.workspace)).job)
    except PipelineError:
        return False
    return bool(ledger.metrics(entry.name)) and all(row.state != "run" for row in rows)


def _stages(job: Job, part: str) -> list[str]:
    """Targets of `e4dgs run`, one after the other: stages of ``part`` that are not in the store. The last part ends with "all", which
    measures and draws the report."""
    rows = make_plan(job)
    of_part = {row.stage: "train" if row.stage in TRAINING else "after" if row.stage == EVALUATION else "before" for row in rows}
    chosen = [row.stage for row in rows if row.state == "run" and of_part[row.stage] == part]
    return ["all"] if part == PARTS[-1] else chosen


def _run(
    ledger: Ledger, entry: Entry, target: str, timeout: float | None, threads: int | None, stopped: Callable[[], bool]
) -> tuple[int | None, float]:
    """Exit code, None where it was ended after ``timeout`` seconds or because it was ``stopped``, and the seconds that it took."""
    command = [sys.executable, "-m", "e4dgs.workflows.cli", "run", target, *words_of(entry.options(ledger.workspace))]
    environment: dict[str, str] = dict(os.environ, PYTHONUNBUFFERED="1")
    if threads is not None:
        environment |= {name: str(threads) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
    log = ledger.log(entry.name)
    log.parent.mkdir(parents=True, exist_ok=True)
    started = time.monotonic()
    with open(log, "ab") as output:
        output.write(f"== {target}\n".encode())
        output.flush()
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, env=environment, start_new_session=True
        )
        code: int | None = None
        try:
            while code is None and not stopped() and (timeout is None or time.monotonic() - started < timeout):
                with contextlib.suppress(subprocess.TimeoutExpired):
                    code = process.wait(LOOK)
        finally:
            _end(process)
    return code, time.monotonic() - started


def _end(process: subprocess.Popen[Any]) -> None:
    """The process and what it has started."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGTERM)
        try:
            process.wait(GRACE)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def _why(ledger: Ledger, scene: str, code: int | None, timeout: float | None) -> str:
    if code is None:
        return f"ended after {timeout:.0f} s (--stage-timeout); what it has done so far is kept"
    if code < 0:
        number = -code
        hint = "; out of memory, perhaps: fewer scenes at a time (--jobs) or smaller pictures" if number == signal.SIGKILL else ""
        return f"ended by {signal.Signals(number).name}{hint}; see {ledger.log(scene)}"
    lines = ledger.log(scene).read_text(errors="replace").strip().splitlines()
    errors = [line for line in lines if line.startswith("error: ")]
    return errors[-1].removeprefix("error: ") if errors else " | ".join(lines[-LAST_LINES:])


def main() -> int:
    """Exit code 0 where the part is done, 1 where it failed."""
    workspace, batch, scene, part = sys.argv[1:5]
    try:
        return 0 if run_part(workspace, batch, scene, part) else 1
    except StageFailed as error:
        print(error, file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
