"""Our rasterizer against the pure blend limit: the same number of (pixel, Gaussian) pairs evaluated and blended, and nothing else."""

from __future__ import annotations

import torch
from e4dgs.workflows.bench.render import both, forward
from e4dgs.workflows.bench.rows import Bench, Check, Measured
from e4dgs.workflows.bench.scenes import garden
from e4dgs.workflows.bench.timing import interleaved, ratio

from ..native.counts import blend_limit, count_pairs

BAR = 2.0


def measure(bench: Bench) -> Measured:
    scene, name = garden(bench)
    pairs = count_pairs(scene)

    def limit_both() -> None:
        blend_limit(pairs.visible, False)
        blend_limit(pairs.visible, True)

    times = interleaved(
        bench,
        {
            "forward": forward(scene),
            "limit forward": lambda: blend_limit(pairs.visible, False),
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
        f"{torch.get_num_threads()} threads",
        checks=checks,
        numbers={"pairs": vars(pairs), "times": {what: timing.json() for what, timing in times.items()}},
        columns=("", "best ms", "median ms", "ns a pair"),
        table=table,
    )
