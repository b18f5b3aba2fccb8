"""What a worker does: it runs the stages of a scene, each in its own process, so that a crash or a hang costs only that stage."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from ...pipeline import Job, PipelineError, Resources, make_plan
from ..reconstruction import EVALUATION, TRAINING
from ..results import words_of
from ..scenes import NameTakenError
from ..session import open_session
from .forks import ForkServers
from .ledger import Ledger, SceneState
from .listing import Entry
from .process import Ended, run_process
from .share import Lease

PARTS = ("before", "train", "after")  # the last two use the GPU if there is one
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")

SERVERS = ForkServers()  # of this process; they end when it ends

Take = Callable[[Resources], AbstractContextManager[Lease]]


class StageFailed(Exception):
    """A stage of a scene failed. The message says which, and why. memory: it failed for lack of memory."""

    def __init__(self, message: str, memory: bool = False) -> None:
        super().__init__(message, memory)  # all arguments, so that pickling between processes keeps them
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
    """Runs the stages that ``part`` of `PARTS` of a scene still needs. If another process works on the scene, waits until that has ended.

    timeout: seconds for each stage. threads: for each stage. memory_gb: a stage that takes more is ended. stopped: polled; True ends the
    stage. take: replaces threads and memory_gb for stages that share this machine, and waits until a stage can run. Returns False if it was
    stopped or the capture is refused, which another try would not change. Raises StageFailed if a stage fails; the scene's state then
    says the same.
    """
    ledger = Ledger(Path(workspace), batch)
    with ledger.at_work(scene, stopped) as ours:
        return ours and _run_part(ledger, scene, part, timeout, stopped, take or _alone(threads, memory_gb))


def _alone(threads: int | None, memory_gb: float | None) -> Take:
    """For a worker with a fixed share of threads and memory from its cluster."""
    return lambda wanted: contextlib.nullcontext(Lease(wanted, threads, memory_gb))


def _run_part(ledger: Ledger, scene: str, part: str, timeout: float | None, stopped: Callable[[], bool], take: Take) -> bool:
    entry = ledger.entry(scene)
    if entry is None:  # since this was submitted, the batch has been given another list, in which nobody looks for the scene's state
        return False
    progress = ledger.progress(scene)
    if progress.state == "done":
        return True
    try:
        session = open_session(entry.options(ledger.workspace))
        if (owner := session.scene.gone) is not None:  # a batch names scenes by itself, and that capture's disk may come back
            raise NameTakenError(session.scene.name, owner, session.scene.folder)
        job = session.job
        stages = _stages(job, part)
    except PipelineError as error:
        message = _name_taken(entry, error) if isinstance(error, NameTakenError) else str(error)
        ledger.write(scene, SceneState("failed", "", message, progress.seconds, progress.attempts + _is_a_try(progress)))
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


def _name_taken(entry: Entry, error: NameTakenError) -> str:
    """--name names the batch, so here scenes are named in a list."""
    advice = f"name this one in a YAML list of the batch, for example - {{capture: {json.dumps(entry.capture)}, name: {entry.name}-2}}"
    return (
        f"{entry.name}: a scene of this name in {error.folder.parent.parent} belongs to {error.owner}; {advice}, or remove {error.folder}"
    )


def is_current(ledger: Ledger, entry: Entry) -> bool:
    """Whether the store still has every result of a scene, with the keys that its capture and this version of e4dgs give."""
    try:
        rows = make_plan(open_session(entry.options(ledger.workspace)).job)
    except PipelineError:
        return False
    return bool(ledger.metrics(entry.name)) and all(row.state != "run" for row in rows)


def _is_a_try(progress: SceneState) -> bool:
    """Whether resuming from ``progress`` is a new try. A stage that was stopped, or lost with its worker, continues the old try."""
    return progress.attempts == 0 or progress.state == "failed"


def _stages(job: Job, part: str) -> list[str]:
    """Targets of `e4dgs run` in order: the stages of ``part`` that are not in the store. The last part is "all", which evaluates and draws
    the report."""
    if part == PARTS[-1]:
        return ["all"]
    return [row.stage for row in make_plan(job) if row.state == "run" and row.stage != EVALUATION and _part_of(job, row.stage) == part]


def _part_of(job: Job, stage: str) -> str:
    """The part that a stage belongs to. Results whose keys depend on the device are made on the training machine, which looks for them
    under its own key."""
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
