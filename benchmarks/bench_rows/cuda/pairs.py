"""What a (pixel, convex) pair costs the GPU against a (pixel, Gaussian) pair, K = 6. The host's time does not count: it is longer here."""

from __future__ import annotations

from e4dgs.workflows.bench.cuda.gpu import both_on_gpu, gpu_name, need_gpu, on_gpu
from e4dgs.workflows.bench.rows import Bench, Check, Measured
from e4dgs.workflows.bench.scenes import CONVEX_COUNT, convexes, garden

from ..native.counts import count_pairs
from ..scenes import reconstructed_convexes
from .gpu_times import gpu_times

BAR = 2.5
PARTS = ("blend_forward", "blend_backward")


def measure(bench: Bench) -> Measured:
    need_gpu()
    base, name = garden(bench)
    width, height, count = base.camera.width, base.camera.height, bench.count(CONVEX_COUNT)
    scenes = {
        "Gaussians": base,
        "convexes": convexes(count, width, height),
        "reconstructed convexes": reconstructed_convexes(count, width, height),
    }
    pairs, seconds = {}, {}
    bench.expect(len(scenes))
    for key, scene in scenes.items():
        pairs[key] = count_pairs(scene).visible
        seconds[key] = gpu_times(both_on_gpu(on_gpu(scene)), 10 * bench.repeats)
        bench.tick(key)
    cost = {key: sum(seconds[key].values()) / pairs[key] for key in scenes}
    checks = [Check(f"{key}: time a pair over Gaussians'", cost[key] / cost["Gaussians"], BAR) for key in scenes if key != "Gaussians"]
    table = [
        (
            key,
            f"{pairs[key] / 1e6:.1f} M",
            *(f"{1e3 * seconds[key].get(part, 0.0):.3f}" for part in PARTS),
            f"{1e3 * sum(seconds[key].values()):.3f}",
            f"{1e9 * cost[key]:.4f}",
        )
        for key in scenes
    ]
    return Measured(
        f"{name} and {count:,} convexes of 6 points at {width}x{height}; all that the GPU does for an image with gradients; {gpu_name()}",
        checks,
        {"pairs": pairs, "seconds": seconds},
        columns=("", "visible pairs", *(f"{part}, ms" for part in PARTS), "all kernels, ms", "ns a pair"),
        table=table,
    )
