"""What a (pixel, convex) pair costs on the GPU against a (pixel, Gaussian) pair, K = 6."""

from __future__ import annotations

from e4dgs.workflows.bench.cuda.gpu import CALLS, both_on_gpu, ending, gpu_name, need_gpu, on_gpu
from e4dgs.workflows.bench.rows import Bench, Check, Measured
from e4dgs.workflows.bench.scenes import CONVEX_COUNT, convexes, garden
from e4dgs.workflows.bench.timing import interleaved

from ..native.counts import count_pairs
from ..scenes import reconstructed_convexes

BAR = 2.5


def measure(bench: Bench) -> Measured:
    need_gpu()
    base, name = garden(bench)
    width, height, count = base.camera.width, base.camera.height, bench.count(CONVEX_COUNT)
    scenes = {
        "Gaussians": base,
        "convexes": convexes(count, width, height),
        "reconstructed convexes": reconstructed_convexes(count, width, height),
    }
    pairs = {key: count_pairs(scene).visible for key, scene in scenes.items()}
    times = interleaved(bench, {key: ending(both_on_gpu(on_gpu(scene))) for key, scene in scenes.items()})
    cost = {key: times[key].best / pairs[key] for key in scenes}
    checks = [Check(f"{key}: time a pair over Gaussians'", cost[key] / cost["Gaussians"], BAR) for key in scenes if key != "Gaussians"]
    table = [
        (key, f"{pairs[key] / 1e6:.1f} M", f"{1e3 * times[key].median / CALLS:.3f}", f"{1e9 * cost[key] / CALLS:.3f}") for key in scenes
    ]
    return Measured(
        f"{name} and {count:,} convexes of 6 points at {width}x{height}; forward + backward; {gpu_name()}",
        checks,
        {"pairs": pairs, "times": {key: t.json() for key, t in times.items()}},
        columns=("", "visible pairs", "median ms", "ns a pair"),
        table=table,
    )
