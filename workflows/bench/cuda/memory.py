"""Checks that what does not fit on the GPU is refused with advice on what to lower, and that the next frame renders as before."""

from __future__ import annotations

import torch

from ..rows import Bench, Check, Measured
from ..scenes import cloud
from .gpu import gpu_name, need_gpu, on_gpu, peak_mib

SPARE = 64 << 20  # bytes that are left free


def measure(bench: Bench) -> Measured:
    need_gpu()
    small = on_gpu(cloud(1000, 64, 64))
    before = small.render("cuda").color.clone()
    width, height = bench.size(1920, 1080)
    large = on_gpu(cloud(bench.count(1_000_000, 2000), width, height, size=0.05))
    free, _ = torch.cuda.mem_get_info()
    hog = torch.empty(max(0, free - SPARE), dtype=torch.uint8, device="cuda")
    said = ""
    try:
        for _ in range(3):
            large.render("cuda")
    except (torch.OutOfMemoryError, MemoryError) as refused:
        said = str(refused)
    del hog
    torch.cuda.empty_cache()  # or the rows that follow would find the GPU full
    same = torch.equal(small.render("cuda").color, before)
    return Measured(
        f"a million Gaussians at {width}x{height} with {SPARE >> 20} MiB of the GPU's memory left; {gpu_name()}",
        [
            Check("refused by an error that names what to lower", float("fewer or smaller primitives" in said), 1.0, "above", unit=""),
            Check("the next frame is as before", float(same), 1.0, "above", unit=""),
            Check("peak of forward + backward when there is room", peak_mib(lambda: large.render("cuda")), unit="MiB"),
        ],
        {"message": said},
    )
