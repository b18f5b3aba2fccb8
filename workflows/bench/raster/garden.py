"""Our rasterizer against the pure blend limit: the same number of (pixel, Gaussian) pairs evaluated and blended, and nothing else."""

from __future__ import annotations

import torch

from ....rasterizer import _cpu  # type: ignore[attr-defined]
from ..render import both, count_pairs, forward
from ..rows import Bench, Check, Measured
from ..scenes import garden
from ..timing import interleaved, ratio

BAR = 2.0


def measure(bench: Bench) -> Measured:
    scene, name = garden(bench)
    pairs = count_pairs(scene)
    threads = torch.get_num_threads()

    def limit_both() -> None:
        _cpu.blend_limit(pairs.visible, False, threads)
        _cpu.blend_limit(pairs.visible, True, threads)

    times = interleaved(
        bench,
        {
            "forward": forward(scene),
            "limit forward": lambda: _cpu.blend_limit(pairs.visible, False, threads),
            "forward + backward": both(scene),
            "limit forward + backward": limit_both,
        },
        2 * bench.repeats,
    )
    checks, table = [], []
    for what in ("forward", "forward + backward"):
        value, note = ratio(times[what], times[f"limit {what}"])
        checks.append(Check(f"{what}, of the blend limit's time", value, BAR, note=note))
    for what, timing in times.items():
        table.append((what, f"{1e3 * timing.best:.1f}", f"{1e3 * timing.median:.1f}", f"{1e9 * timing.best / pairs.visible:.2f}"))
    return Measured(
        protocol=f"{name}; {pairs.visible / 1e6:.1f} M visible pairs, {pairs.blended / 1e6:.1f} M of them before their pixels stop; "
        f"{threads} threads",
        checks=checks,
        numbers={"pairs": vars(pairs), "times": {what: timing.json() for what, timing in times.items()}},
        columns=("", "best ms", "median ms", "ns a pair"),
        table=table,
    )
