"""Wall time of contenders that take turns, so that other load on the machine affects all of them equally."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from .rows import Bench

Run = Callable[[], object]


@dataclass
class Timing:
    """Seconds of each run, without the warm-up."""

    runs: list[float]

    @property
    def best(self) -> float:
        return min(self.runs)

    @property
    def median(self) -> float:
        return statistics.median(self.runs)

    def json(self) -> dict[str, float | int]:
        return {"best_s": self.best, "median_s": self.median, "runs": len(self.runs)}


def timed(run: Run) -> float:
    """Seconds of one run."""
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def interleaved(bench: Bench, contenders: Mapping[str, Run], repeats: int | None = None) -> dict[str, Timing]:
    """Runs every contender once to warm up, then in turns until each has ``repeats`` runs or has used up its seconds (at least one run).

    Every other round has the reverse order, so that no contender always runs after the same one.
    """
    repeats = bench.repeats if repeats is None else repeats
    runs: dict[str, list[float]] = {name: [] for name in contenders}
    spent = dict.fromkeys(contenders, 0.0)
    bench.expect(len(contenders) + repeats)
    for name, run in contenders.items():
        spent[name] += timed(run)
        bench.tick(name)
    for turn in range(repeats):
        names = list(contenders)
        for name in names if turn % 2 == 0 else reversed(names):
            if not runs[name] or spent[name] < bench.seconds:
                runs[name].append(timed(contenders[name]))
                spent[name] += runs[name][-1]
        bench.tick(f"round {turn + 1}")
    return {name: Timing(values) for name, values in runs.items()}


def ratio(slow: Timing, fast: Timing) -> tuple[float, str]:
    """How many times as long ``slow`` takes as ``fast``, by the best runs, and a note with the ratio of the medians."""
    return slow.best / fast.best, f"{slow.median / fast.median:.2f}x by medians"
