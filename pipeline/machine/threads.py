"""How many threads a stage may use."""

import os


def thread_count(most: int | None = None) -> int:
    """OMP_NUM_THREADS if set (a batch sets it for each stage), else the number of cores this process may use; at most ``most``."""
    said = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0]
    affinity = getattr(os, "sched_getaffinity", None)
    count = int(said) if said.isdigit() and int(said) else len(affinity(0)) if affinity else os.cpu_count() or 1
    return count if most is None else min(most, count)


def waiting_threads() -> int:
    """Number of threads for work that mostly waits for the disk: twice `thread_count`, up to eight."""
    return min(8, 2 * thread_count())
