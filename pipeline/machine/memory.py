"""Peak memory of one stage, including helper processes."""

from __future__ import annotations

import contextlib
import threading
from pathlib import Path
from types import TracebackType

import psutil

_SAMPLE_SECONDS = 0.05
_SLACK = 16_000_000  # bytes; the kernel counts pages for each core and adds them up late
_CHILDREN_EVERY = 20  # samples; listing children walks the process table, so it is done only once a second


class PeakMemory:
    """``with PeakMemory() as peak: ...``, then ``peak.mb``: largest resident set of this process and its children, in MB (1e6 bytes).

    The kernel's own high-water mark is reset at the start and read at the end, where the kernel allows that. Samples cover the rest.
    """

    def __init__(self) -> None:
        self._process = psutil.Process()
        self._peak = 0
        self._children = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    @property
    def mb(self) -> float:
        return round(self._peak / 1e6, 1)

    def __enter__(self) -> PeakMemory:
        self._sample()
        # Some kernels accept the reset and ignore it: their mark still tells of what ran before.
        self._has_mark = _reset_mark() and _read_mark() <= self._process.memory_info().rss + _SLACK
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._stop.set()
        self._thread.join()
        self._sample()
        if self._has_mark:
            self._peak = max(self._peak, _read_mark())

    def _watch(self) -> None:
        count = 0
        while not self._stop.wait(_SAMPLE_SECONDS):
            if count % _CHILDREN_EVERY == 0:
                self._children = memory_of_children(self._process)
            count += 1
            self._sample()

    def _sample(self) -> None:
        self._peak = max(self._peak, self._process.memory_info().rss + self._children)


def memory_of_children(process: psutil.Process) -> int:
    """Resident memory of all that ``process`` has started, bytes."""
    total = 0
    with contextlib.suppress(psutil.Error):
        for child in process.children(recursive=True):
            with contextlib.suppress(psutil.Error):
                total += child.memory_info().rss
    return total


def _reset_mark() -> bool:
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return False
    return True


def _read_mark() -> int:
    with contextlib.suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    return 0
