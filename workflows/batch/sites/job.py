"""Runs one part of a scene as a Slurm job.

The scripts of `slurm.py` call ``python -m e4dgs.workflows.batch.sites.job WORKSPACE BATCH SCENE PART [SECONDS]``. A stage that takes
longer than SECONDS is ended.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading

from ..work import StageFailed, run_part

MOST_RESTARTS = 50  # a job that never reaches its first checkpoint would otherwise be requeued forever


def main() -> int:
    """Exit code 0 if the part is done or was requeued, 1 if it failed or was cancelled.

    On SIGUSR1, which Slurm sends before the time limit, the stage is ended and the job requeued; it then resumes from its checkpoint.
    SIGTERM ends the job.
    """
    workspace, batch, scene, part, *seconds = sys.argv[1:]
    timeout = float(seconds[0]) if seconds else None
    stopped, limit = threading.Event(), threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stopped.set())

    def near_the_limit(*_: object) -> None:
        limit.set()
        stopped.set()

    signal.signal(signal.SIGUSR1, near_the_limit)
    try:
        if run_part(workspace, batch, scene, part, timeout, stopped=stopped.is_set):
            return 0
    except StageFailed as error:
        print(error, file=sys.stderr)
        return 1
    return _requeue(scene, part) if limit.is_set() else 1


def _requeue(scene: str, part: str) -> int:
    job, restarts = os.environ.get("SLURM_JOB_ID", ""), int(os.environ.get("SLURM_RESTART_COUNT", "0"))
    if not job or restarts >= MOST_RESTARTS:
        print(f"{scene}: {part}: out of time after {restarts} restarts; submit it again with more time", file=sys.stderr)
        return 1
    print(f"{scene}: {part}: near the time limit; continues in a new job", flush=True)
    return subprocess.run(["scontrol", "requeue", job]).returncode


if __name__ == "__main__":
    sys.exit(main())
