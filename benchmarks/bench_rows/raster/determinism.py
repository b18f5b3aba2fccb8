"""Image and every gradient, bit by bit, over numbers of threads and repeated runs."""

from __future__ import annotations

import torch
from e4dgs.rasterizer.reference.compare import cotangents, weigh
from e4dgs.rasterizer.reference.scene import Scene
from e4dgs.workflows.bench.rows import Bench, Check, Measured
from e4dgs.workflows.bench.scenes import mixed
from torch import Tensor

THREADS = (1, 2, 4)
RUNS = 10


def measure(bench: Bench) -> Measured:
    width, height = bench.size(400, 300)
    scene = mixed(bench.count(10_000, 20), width, height, extras=2)
    bench.expect(len(THREADS) * RUNS)
    before = torch.get_num_threads()
    want: dict[str, Tensor] | None = None
    differing: dict[str, int] = {}
    try:
        for threads in THREADS:
            torch.set_num_threads(threads)
            for run in range(RUNS):
                got = everything(scene)
                want = got if want is None else want
                for name, value in got.items():
                    differing[name] = differing.get(name, 0) + int((value.view(torch.uint8) != want[name].view(torch.uint8)).sum())
                bench.tick(f"{threads} threads, run {run + 1}")
    finally:
        torch.set_num_threads(before)
    worst = max(differing, key=lambda name: differing[name])
    return Measured(
        protocol=f"{bench.count(10_000, 20):,} Gaussians and convexes with SH and extras, {width}x{height}; {len(THREADS) * RUNS} runs "
        f"over {', '.join(map(str, THREADS))} threads; image, alpha, depth, extras, and the gradients of {len(differing) - 4} inputs",
        checks=[
            Check(
                "bytes that differ from the first run",
                float(sum(differing.values())),
                0.0,
                unit="bytes",
                note=worst if differing[worst] else "",
            )
        ],
        numbers={"differing_bytes": differing},
    )


def everything(scene: Scene) -> dict[str, Tensor]:
    """Every output, and the gradient of every input for fixed random weights of all outputs."""
    leaves = scene.leaves()
    frame = scene.having(leaves).render("cpu")
    weigh(frame, cotangents(frame)).backward()
    outputs = {name: getattr(frame, name).detach() for name in ("color", "alpha", "depth", "extras")}
    gradients = {f"gradient of {name}": leaf.grad for name, leaf in leaves.items() if leaf.grad is not None}
    return {name: value.contiguous() for name, value in (outputs | gradients).items()}
