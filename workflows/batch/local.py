"""Scenes of a batch on this machine, several at a time; one at a time trains where there is a GPU."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor

from ..devices import resolve_device
from .ledger import Ledger
from .listing import Entry
from .work import PARTS, StageFailed, run_part

MOST_JOBS = 2  # by default, where there are not four cores for each


def cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def usual_jobs() -> int:
    """One for each four cores, two at least: decoding and structure from motion of one scene fill what training of another leaves."""
    return max(min(MOST_JOBS, cores()), cores() // 4)


class Local:
    """Runs scenes until all are done or have failed.

    jobs: scenes at a time, which share the cores. retries: further tries of a scene whose stage failed. timeout: seconds for each stage.
    """

    def __init__(self, ledger: Ledger, jobs: int, retries: int, timeout: float | None) -> None:
        self.ledger, self.retries, self.timeout = ledger, retries, timeout
        self.threads = max(1, cores() // jobs)
        self._gpu = threading.Semaphore(1)
        self._pool = ThreadPoolExecutor(jobs, thread_name_prefix="scene")
        self._stopped = threading.Event()

    def start(self, entries: Sequence[Entry]) -> list[Future[bool]]:
        return [self._pool.submit(self._scene, entry) for entry in entries]

    def stop(self) -> None:
        """Stages that run are ended; their checkpoints stay."""
        self._stopped.set()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _scene(self, entry: Entry) -> bool:
        for attempt in range(self.retries + 1):
            try:
                return all(self._part(entry, part) for part in PARTS)
            except StageFailed:
                if attempt == self.retries or self._stopped.is_set():
                    return False
        return False

    def _part(self, entry: Entry, part: str) -> bool:
        if self._stopped.is_set():
            return False
        alone = part == "train" and resolve_device(entry.device) == "cuda"
        with self._gpu if alone else contextlib.nullcontext():
            where = str(self.ledger.workspace), self.ledger.name, entry.name
            return run_part(*where, part, self.timeout, self.threads, self._stopped.is_set)
