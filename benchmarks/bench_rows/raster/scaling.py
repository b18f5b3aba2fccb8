"""Time of an image with gradients over the number of primitives, of pixels, and of threads: Gaussians, convexes, and both."""

from __future__ import annotations

import os
from collections.abc import Callable

import torch
from e4dgs.rasterizer.reference.scene import Scene
from e4dgs.workflows.bench.render import both
from e4dgs.workflows.bench.rows import Bench, Measured
from e4dgs.workflows.bench.scenes import cloud, convexes, mixed
from e4dgs.workflows.bench.timing import Timing, interleaved

from ..curves import Curve, Plotted

COUNTS = (1_000, 4_000, 16_000, 64_000, 256_000)
SIZES = ((162, 105), (324, 210), (648, 420), (1296, 840), (1920, 1080))
FIXED_COUNT, FIXED_SIZE = 16_000, (648, 420)
KINDS: dict[str, Callable[[int, int, int], Scene]] = {"Gaussians": cloud, "convexes": convexes, "both": mixed}
REPEATS = 3


def measure(bench: Bench) -> Measured:
    curves: list[Curve] = []
    numbers: dict[str, object] = {}

    def add(axis: str, title: str, xs: list[float], times: dict[str, list[Timing]]) -> None:
        for kind, timings in times.items():
            curves.append(Curve(f"over_{axis}", kind, xs, [1e3 * t.best for t in timings], title, "forward + backward, ms"))
        numbers[axis] = {"x": xs} | {kind: [t.json() for t in timings] for kind, timings in times.items()}

    width, height = bench.size(*FIXED_SIZE)
    counts = [bench.count(n, 10) for n in COUNTS]
    add("primitives", "primitives", list(map(float, counts)), _over(bench, [(n, width, height) for n in counts]))
    fixed = bench.count(FIXED_COUNT, 10)
    sizes = [bench.size(*size) for size in SIZES]
    add("pixels", "pixels", [float(w * h) for w, h in sizes], _over(bench, [(fixed, w, h) for w, h in sizes]))
    before = torch.get_num_threads()
    threads = sorted({*(2**k for k in range(8) if 2**k <= (os.cpu_count() or 1)), os.cpu_count() or 1})
    found: dict[str, list[Timing]] = {kind: [] for kind in KINDS}
    try:
        for count in threads:
            torch.set_num_threads(count)
            for kind, (timing,) in _over(bench, [(fixed, width, height)]).items():
                found[kind].append(timing)
    finally:
        torch.set_num_threads(before)
    add("threads", "threads", list(map(float, threads)), found)
    table = [_cells(curve.plot.removeprefix("over_"), kind, curve) for curve in curves for kind in [curve.label]]
    return Plotted(
        protocol=f"forward + backward; {fixed:,} primitives at {width}x{height} unless they are what varies; {before} threads",
        numbers=numbers,
        curves=curves,
        columns=("over", "kind", "ms at each size"),
        table=table,
    )


def _over(bench: Bench, sizes: list[tuple[int, int, int]]) -> dict[str, list[Timing]]:
    """Times of each kind at each (primitives, width, height)."""
    found: dict[str, list[Timing]] = {kind: [] for kind in KINDS}
    for n, width, height in sizes:
        times = interleaved(bench, {kind: both(make(n, width, height)) for kind, make in KINDS.items()}, min(REPEATS, bench.repeats))
        for kind, timing in times.items():
            found[kind].append(timing)
    return found


def _cells(axis: str, kind: str, curve: Curve) -> tuple[str, ...]:
    return axis, kind, "   ".join(f"{x:,.0f}: {y:.1f}" for x, y in zip(curve.x, curve.y))
