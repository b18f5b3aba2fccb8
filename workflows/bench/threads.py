"""CPU kernels compared with themselves: on all threads, and on one."""

from __future__ import annotations

from collections.abc import Mapping

import torch

from ...rasterizer import _cpu  # type: ignore[attr-defined]
from .rows import Bench, Check, Measured
from .timing import Run, interleaved, ratio

BAR = 1.0  # times the time on one thread; if more threads take longer, something else is using the cores


def over_threads(bench: Bench, what: str, runs: Mapping[str, Run]) -> Measured:
    """Times each of ``runs`` on all threads and, if there are several, on one. ``what`` is the beginning of the protocol."""
    threads = torch.get_num_threads()
    counts = {threads: f"{threads} threads", 1: "1 thread"}

    def on(count: int, run: Run) -> Run:
        def call() -> None:
            torch.set_num_threads(count)
            run()

        return call

    try:
        times = interleaved(bench, {f"{name}, {words}": on(count, run) for name, run in runs.items() for count, words in counts.items()})
    finally:
        torch.set_num_threads(threads)
    checks = []
    for name in runs if threads > 1 else ():
        value, note = ratio(times[f"{name}, {counts[threads]}"], times[f"{name}, {counts[1]}"])
        checks.append(Check(f"{name}, time on {threads} threads over that on one", value, BAR, note=note))
    return Measured(
        f"{what}; {_cpu.kernels()} kernels",
        checks,
        {"times": {name: timing.json() for name, timing in times.items()}},
        columns=("", "best ms", "median ms"),
        table=[(name, f"{1e3 * t.best:.2f}", f"{1e3 * t.median:.2f}") for name, t in times.items()],
    )
