"""python eight_runs.py ROOT SEED KILLS [unlocked]: eight runs of one capture at a time; some are killed and begun anew.

Prints JSON: which processes were killed, how the others ended, every call of a stage (stage, process), and every result of a run.
unlocked: as on a network file system whose locks do nothing.
"""

import fcntl
import json
import os
import random
import signal
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import toy_stages
import zarr  # noqa: F401  (before the processes part, so that each need not import it)
from e4dgs.pipeline import PipelineError, Runner, Settings, Stage

RUNS, LONGEST = 8, 60.0  # processes at a time; seconds until the last must have ended


def append(path: Path, *words: object) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.write(descriptor, (json.dumps(words) + "\n").encode())
    os.close(descriptor)


class First(Stage):
    """Takes a while, and writes several chunks."""

    name = "first"
    settings = Settings
    reads_capture = True

    def run(self, ctx: Any) -> None:
        append(ctx.capture.root.parent / "calls.jsonl", self.name, os.getpid())
        out = ctx.out.create("values", (6, 100), np.float64, (1, 100))
        for row in range(6):
            time.sleep(0.01)
            out[row] = row + sum(artifact.read("values").sum() for artifact in ctx.inputs.values())


class Second(First):
    name = "second"
    inputs = ("first",)


class Third(First):
    name = "third"
    inputs = ("first", "second")


def work(root: Path) -> int:
    job = toy_stages.Bench(root).job(First(), Second(), Third())
    try:
        outcomes = Runner(job).run()
    except (PipelineError, OSError) as error:
        append(root / "errors.jsonl", type(error).__name__, str(error))
        return 1
    for outcome in outcomes:
        assert outcome.artifact is not None
        outcome.artifact.read("values")
        append(root / "results.jsonl", outcome.stage, outcome.artifact.path.name, outcome.artifact.digest)
    return 0


def begin(root: Path) -> int:
    process = os.fork()
    if process == 0:
        code = 70
        try:
            code = work(root)
        finally:
            os._exit(code)
    return process


def main() -> None:
    root, chance, kills = Path(sys.argv[1]), random.Random(int(sys.argv[2])), int(sys.argv[3])
    if "unlocked" in sys.argv:
        fcntl.flock = lambda descriptor, operation: None
    running, killed, codes = [begin(root) for _ in range(RUNS)], [], []
    began = time.monotonic()
    while running:
        time.sleep(chance.uniform(0.005, 0.05))
        if len(killed) < kills:
            victim = running.pop(chance.randrange(len(running)))
            os.kill(victim, signal.SIGKILL)
            _, status = os.waitpid(victim, 0)
            (killed if os.WIFSIGNALED(status) else codes).append(victim if os.WIFSIGNALED(status) else os.waitstatus_to_exitcode(status))
            running.append(begin(root))
        for process in [*running]:
            ended, status = os.waitpid(process, os.WNOHANG)
            if ended:
                running.remove(process)
                codes.append(os.waitstatus_to_exitcode(status))
                if len(killed) < kills:
                    running.append(begin(root))
        if time.monotonic() - began > LONGEST:
            for process in running:
                os.kill(process, signal.SIGKILL)
            raise SystemExit(f"deadlock: {len(running)} runs did not end")
    found = {name: [json.loads(line) for line in read(root / f"{name}.jsonl")] for name in ("calls", "results", "errors")}
    print(json.dumps({"killed": killed, "codes": codes, **found}))


def read(path: Path) -> list[str]:
    return path.read_text().splitlines() if path.exists() else []


if __name__ == "__main__":
    main()
