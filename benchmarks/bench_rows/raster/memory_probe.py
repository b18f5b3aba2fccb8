"""Renders once in a process of its own and prints, as JSON, by how much its memory grew: `python -m ... N WIDTH HEIGHT SIZE [LIMIT_GIB]`.

LIMIT_GIB bounds the process's address space, so that a scene that is too large cannot take the machine down.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from pathlib import Path

GIB = 2**30


def main() -> None:
    import psutil
    from e4dgs.workflows.bench.render import both
    from e4dgs.workflows.bench.scenes import cloud

    n, width, height, size = int(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
    both(cloud(100, 64, 48))()  # libraries load, threads start
    run = both(cloud(n, width, height, degree=3, size=size))
    before = psutil.Process().memory_info().rss
    if len(sys.argv) > 5:
        limit = psutil.Process().memory_info().vms + int(float(sys.argv[5]) * GIB)
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    found: dict[str, object] = {"n": n, "width": width, "height": height, "before_gib": before / GIB, "error": None, "message": ""}
    start = time.perf_counter()
    try:
        run()
    except (MemoryError, RuntimeError) as error:
        found |= {"error": type(error).__name__, "message": str(error)}
    found["seconds"] = time.perf_counter() - start
    found["growth_gib"] = max(0.0, peak_rss() - before) / GIB
    print(json.dumps(found))


def peak_rss() -> int:
    """Bytes. The kernel's own mark where there is one: getrusage's also remembers the process that started this one."""
    try:
        status = Path("/proc/self/status").read_text()
        return 1024 * int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM:")))
    except (OSError, StopIteration):
        return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


if __name__ == "__main__":
    main()
