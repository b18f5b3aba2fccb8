"""Time and error of what can be turned at run time: the instruction set, and the degree of the spherical harmonics.

What can only be turned when the kernels are compiled is measured by `benchmarks/knobs.py`, which needs the sources.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from e4dgs.rasterizer import _cpu
from e4dgs.rasterizer.reference.scene import Scene
from e4dgs.workflows.bench.render import both
from e4dgs.workflows.bench.rows import Bench, Measured
from e4dgs.workflows.bench.scenes import cloud
from e4dgs.workflows.bench.timing import interleaved
from rasterizer.thresholds import decided_by_threshold

from ..curves import Curve, Plotted
from .accuracy import COUNT, HEIGHT, WIDTH, errors, image_error, large_gaussians

KERNELS = ("avx512", "avx2", "baseline")
DEGREES = (2, 1, 0)  # of 3, which the instruction sets are timed with
TIMED = 60_000


def measure(bench: Bench) -> Measured:
    width, height = bench.size(648, 420)
    n = bench.count(TIMED, 20)
    small = large_gaussians(bench.count(COUNT, 10), *bench.size(WIDTH, HEIGHT))
    decided = decided_by_threshold(small)
    scene = cloud(n, width, height, degree=3)
    best = _cpu.kernels()
    usable = [name for name in KERNELS if _cpu.select_kernels(name)]
    found: dict[str, dict[str, float]] = {}
    try:
        # One and the same list of contenders: every point of the plot has had the same neighbours.
        whole = both(scene)
        runs = {name: _with_kernels(name, whole) for name in usable}
        runs |= {f"SH {degree}": _with_kernels(best, both(truncated(scene, degree))) for degree in DEGREES}
        times = interleaved(bench, runs)
        for name in usable:
            _cpu.select_kernels(name)
            image, gradients = errors(small, decided)
            found[name] = {"ms": 1e3 * times[name].best, "image": image, "gradient": max(gradients.values())}
    finally:
        _cpu.select_kernels(best)
    with torch.no_grad():
        want = small.to(torch.float64).render("reference")
        for degree in DEGREES:
            got = truncated(small, degree).render("cpu")
            found[f"SH {degree}"] = {"ms": 1e3 * times[f"SH {degree}"].best, "image": image_error(got, want, decided)}
    return Plotted(
        protocol=f"time: {n:,} Gaussians with SH, {width}x{height}, forward + backward; error: image and gradients of a smaller scene "
        f"against float64 with SH of degree 3; {torch.get_num_threads()} threads",
        numbers=found,
        curves=[Curve("knobs", name, [v["ms"]], [v["image"]], "ms", "largest error of the image", [name]) for name, v in found.items()],
        columns=("", "best ms", "image", "gradient"),
        table=[
            (name, f"{v['ms']:.1f}", f"{v['image']:.1e}", f"{v['gradient']:.1e}" if "gradient" in v else "") for name, v in found.items()
        ],
    )


def _with_kernels(name: str, run: Callable[[], object]) -> Callable[[], None]:
    def on() -> None:
        _cpu.select_kernels(name)
        run()

    return on


def truncated(scene: Scene, degree: int) -> Scene:
    """The scene with the bands of its harmonics above ``degree`` left out."""
    assert scene.gaussians is not None and scene.gaussians.sh is not None
    return replace(scene, gaussians=replace(scene.gaussians, sh=scene.gaussians.sh[:, : (degree + 1) ** 2].contiguous()))
