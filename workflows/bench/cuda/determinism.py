"""Sums in a fixed order: whether they are bit-equal over ten runs, and what they cost."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from ....rasterizer.reference.compare import cotangents, weigh
from ..rows import Bench, Check, Measured
from ..scenes import garden, mixed
from ..timing import interleaved, ratio
from .gpu import both_on_gpu, ending, gpu_name, need_gpu, on_gpu

RUNS, BAR = 10, 1.5


def measure(bench: Bench) -> Measured:
    need_gpu()
    width, height = bench.size(400, 300)
    scene = on_gpu(mixed(bench.count(10_000, 20), width, height, extras=2))
    large, name = garden(bench)
    usual = both_on_gpu(on_gpu(large))

    def fixed() -> None:
        with in_fixed_order():
            usual()

    bench.expect(RUNS)
    differing, first = 0, None
    with in_fixed_order():
        for run in range(RUNS):
            leaves = scene.leaves()
            frame = scene.having(leaves).render("cuda")
            weights = {key: value.cuda() for key, value in cotangents(frame).items()}
            weigh(frame, weights).backward()
            found = [frame.color.detach(), frame.depth.detach(), *(leaf.grad for leaf in leaves.values() if leaf.grad is not None)]
            first = found if first is None else first
            differing += sum(int((a != b).sum()) for a, b in zip(found, first))
            bench.tick(f"run {run + 1}")
    times = interleaved(bench, {"usual": ending(usual), "fixed order": ending(fixed)})
    value, note = ratio(times["fixed order"], times["usual"])
    return Measured(
        f"{RUNS} runs of Gaussians and convexes with extras at {width}x{height}; time of forward + backward of {name}; {gpu_name()}",
        [
            Check("numbers that differ from the first run's", float(differing), 0.0, unit=""),
            Check("time over the usual", value, BAR, note=note),
        ],
        {"times": {key: timing.json() for key, timing in times.items()}},
    )


@contextmanager
def in_fixed_order() -> Iterator[None]:
    torch.use_deterministic_algorithms(True)
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(False)
