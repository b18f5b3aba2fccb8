"""All rows: those of `e4dgs bench`, and those that exist for benchmarks/results/benchmarks.md."""

from __future__ import annotations

from e4dgs.workflows.bench import suites
from e4dgs.workflows.bench.rows import Row

OWN = {
    "raster": {
        "limit": "garden against the pure blend limit of this processor",
        "torch": "garden against a tile rasterizer in plain torch",
        "pairs": "cost of a (pixel, convex) pair against that of a (pixel, Gaussian) pair",
        "memory": "peak memory of a million Gaussians at 1920x1080, and what is too large for this machine",
        "determinism": "image and gradients over numbers of threads and runs, bit by bit",
        "accuracy": "image and gradients against the float64 reference",
        "scaling": "time over primitives, pixels and threads",
        "knobs": "time and error for what can be turned at run time: instruction set, SH degree",
    },
    "field": {
        "field_torch": "the deformation field at 30,000 points against its composition of torch operations",
        "loss_torch": "L1 + SSIM at 400x400 against separable convolutions in torch",
        "adam_torch": "the optimiser on 30,000 Gaussians against torch's foreach and fused Adam",
    },
    "cuda": {
        "gsplat": "time and memory beside gsplat on its garden scene, tiled 1, 4 and 16 times, at two sizes",
        "pairs": "cost of a (pixel, convex) pair against that of a (pixel, Gaussian) pair",
    },
    "step": {"torch": "a whole training step on 30,000 Gaussians against the same step composed of torch operations"},
}
SUITES: dict[str, list[Row]] = {
    suite: [*suites.SUITES[suite], *(suites.row(name, what, f"{__package__}.{suite}.{name}") for name, what in own.items())]
    for suite, own in OWN.items()
}
