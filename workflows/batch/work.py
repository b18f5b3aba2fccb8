"""What a worker does: the stages of a scene, each in a process of its own, so that a crash or a hang costs that stage and nothing else."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from ...pipeline import Job, PipelineError, Resources, make_plan
from ..reconstruction import EVALUATION, TRAINING
from ..results import words_of
from ..session import open_session
from .forks import ForkServers
from .ledger import Ledger, Progress
from .listing import Entry
from .process import Ended, run_process
from .share import Lease

PARTS = ("before", "train", "after")  # where there is a GPU, the last two want it
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")

SERVERS = ForkServers()  # of this process; they end with it

Take = Callable[[Resources], AbstractContextManager[Lease]]


class StageFailed(Exception):
    """A stage of a scene failed. The message says which, and why. memory: for want of memory."""

    def __init__(self, message: str, memory: bool = False) -> None:
        super().__init__(message, memory)  # all arguments, so that it comes whole from another process
        self.message, self.memory = message, memory

    def __str__(self) -> str:
        return self.message


def run_part(
    workspace: str,
    batch: str,
    scene: str,
    part: str,
    timeout: float | None = None,
    threads: int | None = None,
    memory_gb: float | None = None,
    stopped: Callable[[], bool] = lambda: False,
    take: Take | None = None,
) -> bool:
    """Run what ``part`` of `PARTS` of a scene still needs. Where another process is at work on the scene, wait until it has ended.

    timeout: seconds for each stage. threads: for each stage. memory_gb: more ends a stage. stopped: asked now and then; True ends the
    stage. take: in place of the two before, what stages on this machine share; it waits until a stage can run. Returns False where it
    was stopped, or the capture is refused, which another try would not change. Raises StageFailed where a stage fails; the scene's state
    says the same.
    """
    ledger = Ledger(Path(workspace), batch)
    with ledger.at_work(scene, stopped) as ours:
        return ours and _run_part(ledger, scene, part, timeout, stopped, take or _alone(threads, memory_gb))


def _alone(threads: int | None, memory_gb: float | None) -> Take:
    """For a worker whose cluster has given it what it may take."""
    return lambda wanted: contextlib.nullcontext(Lease(wanted, threads, memory_gb))


def _run_part(
    ledger: Ledger,
    scene: str,
    part: str,
    timeout: float | None,
    stopped: Callable[[], bool],
    take: Take,
) -> bool:
    entry = next(entry for entry in ledger.entries() if entry.name == scene)
    progress = ledger.progress(scene)
    if progress.state == "done":
        return True
    try:
        session = open_session(entry.options(ledger.workspace))
        job = session.job
        stages = _stages(job, part)
    except PipelineError as error:
        ledger.write(scene, Progress("failed", "", str(error), progress.seconds, progress.attempts + _is_a_try(progress)))
        return False
    progress.attempts += _is_a_try(progress)
    for target in stages:
        stage = EVALUATION if target == "all" else target
        wanted = job.graph[stage].resources(job.capture.facts, job.settings[stage], job.device)
        with take(wanted) as lease:
            if stopped():
                return False
            progress.state, progress.stage, progress.message = "running", stage, ""
            ledger.write(scene, progress)
            ended = _run(ledger, entry, target, timeout, lease, stopped)
        progress.seconds = round(progress.seconds + ended.seconds, 1)
        if stopped() and ended.code != 0:
            progress.state = "waiting"
            ledger.write(scene, progress)
            return False
        if ended.code != 0:
            progress.state, progress.message = "failed", ended.problem
            ledger.write(scene, progress)
            if ended.code == 2:
                return False
            raise StageFailed(f"{scene}: {progress.stage}: {progress.message}", ended.memory)
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


def _is_a_try(progress: Progress) -> bool:
    """Whether going on from ``progress`` is a new try. A stage that was stopped, or lost with its worker, goes on with the old one."""
    return progress.attempts == 0 or progress.state == "failed"


def _stages(job: Job, part: str) -> list[str]:
    """Targets of `e4dgs run`, one after the other: stages of ``part`` that are not in the store. The last part ends with "all", which
    measures and draws the report."""
    if part == PARTS[-1]:
        return ["all"]
    return [row.stage for row in make_plan(job) if row.state == "run" and row.stage != EVALUATION and _part_of(job, row.stage) == part]


def _part_of(job: Job, stage: str) -> str:
    """Results that are kept apart by device belong to the machine that trains: another one would look for them under another key."""
    return "train" if stage in TRAINING or job.graph[stage].device_class else "before"


def _run(ledger: Ledger, entry: Entry, target: str, timeout: float | None, lease: Lease, stopped: Callable[[], bool]) -> Ended:
    arguments = ["run", target, *words_of(entry.options(ledger.workspace))]
    environment = dict(os.environ, PYTHONUNBUFFERED="1")
    if lease.threads is not None:
        environment |= dict.fromkeys(THREADS, str(lease.threads))
    log = ledger.log(entry.name)
    log.parent.mkdir(parents=True, exist_ok=True)
    with open(log, "a") as output:
        output.write(f"== {target}\n")
    return run_process(lambda: SERVERS.fork(arguments, environment, log), log, timeout, lease.too_large, stopped)
