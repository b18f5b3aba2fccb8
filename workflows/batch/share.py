"""What the stages that run at the same time on a machine share: its cores, its memory and its GPU."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import psutil

from ...pipeline import Resources

OURS = 0.9  # of the machine's memory, by default
LOOK = 0.5  # s; nobody tells a stage that waits that the batch was stopped
LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")  # of a container


@dataclass(eq=False)  # two stages that want the same are still two stages
class Lease:
    """What a stage may take. threads: None leaves it to the stage. most_gb: more ends it; None for no bound. used_gb: what it was seen to
    take last."""

    wanted: Resources
    threads: int | None = None
    most_gb: float | None = None
    used_gb: float = 0.0

    def too_large(self, used_gb: float) -> str:
        """Why the stage has to end now that it takes ``used_gb``; "" where it may go on."""
        self.used_gb = used_gb
        if self.most_gb is None or used_gb <= self.most_gb:
            return ""
        return (
            f"ended at {used_gb:.1f} GB: a worker of this pool may take {self.most_gb:.1f} GB (memory_gb); "
            f"use smaller pictures (--set frames.max_size=N) or more memory"
        )


class Share:
    """One stage at a time has the GPU; the memory that stages say they take stays below ``memory_gb``, unless one runs alone.

    cores: to be divided among the scenes of the batch that are at work. stopped: asked while a stage waits.
    """

    def __init__(self, cores: int, memory_gb: float, stopped: Callable[[], bool]) -> None:
        self.cores, self.memory_gb, self._stopped = cores, memory_gb, stopped
        self._changed = threading.Condition()
        self._waiting: list[Lease] = []
        self._running: list[Lease] = []

    @contextlib.contextmanager
    def take(self, wanted: Resources, scenes: int) -> Iterator[Lease]:
        """Waits until the stage can run, or the batch was stopped. scenes: that are at work now, this one included."""
        threads = max(1, self.cores // max(1, scenes))
        lease = _Shared(wanted, min(threads, wanted.cores or threads), share=self)
        with self._changed:
            self._waiting.append(lease)
            while not (self._fits(lease) or self._stopped()):
                self._changed.wait(LOOK)
            self._waiting.remove(lease)
            self._running.append(lease)
        try:
            yield lease
        finally:
            with self._changed:
                self._running.remove(lease)
                self._changed.notify_all()

    def _fits(self, lease: Lease) -> bool:
        busy = any(one.wanted.gpu for one in self._running)
        if lease.wanted.gpu and busy:
            return False
        # Who came before keeps its place, else a large stage would wait until the small ones have all been run.
        before = self._waiting[: self._waiting.index(lease)]
        ahead = [one for one in before if not (one.wanted.gpu and busy)]
        taken = sum(one.wanted.memory_gb for one in (*self._running, *ahead))
        return not (self._running or ahead) or taken + lease.wanted.memory_gb <= self.memory_gb

    def too_large(self, lease: Lease) -> str:
        """The stage that takes most above what it said has to go where all take too much."""
        with self._changed:
            excess = {id(one): one.used_gb - one.wanted.memory_gb for one in self._running}
            total = sum(one.used_gb for one in self._running)
        if total <= self.memory_gb or excess[id(lease)] < max(excess.values()):
            return ""
        return (
            f"ended at {lease.used_gb:.1f} GB: all stages together took {total:.1f} GB and may take {self.memory_gb:.1f} GB (--memory); "
            f"use smaller pictures (--set frames.max_size=N) or more memory"
        )


@dataclass(eq=False)
class _Shared(Lease):
    share: Share | None = None

    def too_large(self, used_gb: float) -> str:
        self.used_gb = used_gb
        assert self.share is not None
        return self.share.too_large(self)


def cores() -> int:
    """That this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def usual_memory_gb() -> float:
    """Of this machine, or of the container, without what the system and others need."""
    found = psutil.virtual_memory().total
    for file in LIMITS:
        with contextlib.suppress(OSError, ValueError):
            found = min(found, int(Path(file).read_text()))
    return OURS * found / 1e9
