"""Runs the scenes of a batch on this machine, several at a time. They share its cores, memory and GPU."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

from ...pipeline import Resources
from .ledger import Ledger, SceneState
from .listing import Entry
from .share import Lease, Share, cores
from .work import PARTS, SERVERS, StageFailed, run_part

MOST_JOBS = 2  # default on machines with fewer than four cores for each scene


def usual_jobs() -> int:
    """One scene for every four cores, but at least two if there are two cores: decoding and structure from motion of one scene use the
    cores that training of the other leaves idle."""
    return max(min(MOST_JOBS, cores()), cores() // 4)


class Local:
    """Runs scenes until all are done or have failed.

    jobs: scenes at a time. memory_gb: for all stages together. retries: further tries of a scene with a failed stage. timeout: seconds for
    each stage.
    """

    def __init__(self, ledger: Ledger, jobs: int, memory_gb: float, retries: int, timeout: float | None) -> None:
        self.ledger, self.retries, self.timeout, self.jobs = ledger, retries, timeout, jobs
        self._pool = ThreadPoolExecutor(jobs, thread_name_prefix="scene")
        self._stopped = threading.Event()
        self._share = Share(cores(), memory_gb, self._stopped.is_set)
        self._left = 0  # scenes that have not ended yet
        self._lock = threading.Lock()

    def start(self, entries: Sequence[Entry]) -> list[Future[bool]]:
        self._left = len(entries)
        futures = [self._pool.submit(self._scene, entry) for entry in entries]
        for future in futures:
            future.add_done_callback(self._ended)
        return futures

    def stop(self) -> None:
        """Ends the running stages; their checkpoints stay."""
        self._stopped.set()
        self._pool.shutdown(wait=True, cancel_futures=True)
        SERVERS.close()

    def _ended(self, _: Future[bool]) -> None:
        with self._lock:
            self._left -= 1

    def _scene(self, entry: Entry) -> bool:
        alone = False
        for _ in range(self.retries + 1):
            try:
                return all(self._part(entry, part, alone) for part in PARTS)
            except StageFailed as error:
                alone = error.memory
            except Exception as error:  # for example no process could be started, or the scene's files cannot be read
                # Nobody reads the future's exception, so it is recorded here.
                self._failed(entry.name, error)
            if self._stopped.is_set():
                break
        return False

    def _failed(self, scene: str, error: Exception) -> None:
        before = self.ledger.progress(scene)
        message = f"{type(error).__name__}: {error}"
        self.ledger.write(scene, SceneState("failed", before.stage, message, before.seconds, before.attempts))

    def _part(self, entry: Entry, part: str, alone: bool) -> bool:
        @contextlib.contextmanager
        def take(wanted: Resources) -> Iterator[Lease]:
            if alone:  # it failed for lack of memory, so it gets all there is
                wanted = replace(wanted, memory_gb=max(wanted.memory_gb, self._share.memory_gb))
            with self._share.take(wanted, min(self.jobs, self._left)) as lease:
                yield lease

        if self._stopped.is_set():
            return False
        where = str(self.ledger.workspace), self.ledger.name, entry.name
        return run_part(*where, part, self.timeout, stopped=self._stopped.is_set, take=take)
