"""Shares a machine's cores, memory and GPU among the stages that run on it at the same time."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import psutil

from ...pipeline import Resources

OURS = 0.9  # default share of the machine's memory
LOOK = 0.5  # s; a waiting stage is not notified when the batch is stopped, so it checks this often
LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")  # memory limits of a container


@dataclass(eq=False)  # two stages that want the same are still two stages
class Lease:
    """What a stage may use. threads: None leaves it to the stage. most_gb: a stage that takes more is ended; None for no limit. used_gb:
    memory that it was last seen to use. share: of a machine that several stages use, which then says who must end."""

    wanted: Resources
    threads: int | None = None
    most_gb: float | None = None
    used_gb: float = 0.0
    share: Share | None = None

    def too_large(self, used_gb: float) -> str:
        """Why the stage must end now that it uses ``used_gb``; "" if it may go on."""
        self.used_gb = used_gb
        if self.share is not None:
            return self.share.too_large(self)
        if self.most_gb is None or used_gb <= self.most_gb:
            return ""
        return (
            f"ended at {used_gb:.1f} GB: a worker of this pool may take {self.most_gb:.1f} GB (memory_gb); "
            f"use smaller pictures (--set frames.max_size=N) or more memory"
        )


class Share:
    """One stage at a time has the GPU. The declared memory of all running stages stays below ``memory_gb``, unless one runs alone.

    cores: divided among the scenes that are being worked on. stopped: polled while a stage waits.
    """

    def __init__(self, cores: int, memory_gb: float, stopped: Callable[[], bool]) -> None:
        self.cores, self.memory_gb, self._stopped = cores, memory_gb, stopped
        self._changed = threading.Condition()
        self._waiting: list[Lease] = []
        self._running: list[Lease] = []

    @contextlib.contextmanager
    def take(self, wanted: Resources, scenes: int) -> Iterator[Lease]:
        """Waits until the stage can run or the batch was stopped. scenes: number being worked on now, including this one."""
        threads = max(1, self.cores // max(1, scenes))
        lease = Lease(wanted, min(threads, wanted.cores or threads), share=self)
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
        # Earlier stages keep their place in the queue; otherwise a large stage would wait until all small ones have run.
        before = self._waiting[: self._waiting.index(lease)]
        ahead = [one for one in before if not (one.wanted.gpu and busy)]
        taken = sum(one.wanted.memory_gb for one in (*self._running, *ahead))
        return not (self._running or ahead) or taken + lease.wanted.memory_gb <= self.memory_gb

    def too_large(self, lease: Lease) -> str:
        """If all stages together use too much, the one that exceeds its declared memory most must end."""
        with self._changed:
            excess = {id(one): one.used_gb - one.wanted.memory_gb for one in self._running}
            total = sum(one.used_gb for one in self._running)
        if total <= self.memory_gb or excess[id(lease)] < max(excess.values()):
            return ""
        return (
            f"ended at {lease.used_gb:.1f} GB: all stages together took {total:.1f} GB and may take {self.memory_gb:.1f} GB (--memory); "
            f"use smaller pictures (--set frames.max_size=N) or more memory"
        )


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def usual_memory_gb() -> float:
    """Memory of this machine or container, without a share for the system and other programs."""
    found = psutil.virtual_memory().total
    for file in LIMITS:
        with contextlib.suppress(OSError, ValueError):
            found = min(found, int(Path(file).read_text()))
    return OURS * found / 1e9
