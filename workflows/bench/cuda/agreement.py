"""Compares images and gradients of the CUDA kernels with the CPU kernels', on scenes that are too large for the reference."""

from __future__ import annotations

import torch

from ....rasterizer.reference.compare import cotangents, gradients, relative_l2
from ..rows import Bench, Check, Measured
from ..scenes import garden, mixed
from .gpu import gpu_name, need_gpu, on_gpu

IMAGE, GRADIENT = 1e-4, 1e-3
FLIPS = 1e-3  # share of pixels for which a threshold may decide differently


def measure(bench: Bench) -> Measured:
    need_gpu()
    width, height = bench.size(400, 300)
    scenes = {"garden": garden(bench)[0], "mixed": mixed(bench.count(10_000, 20), width, height, extras=2)}
    checks = []
    bench.expect(len(scenes))
    for name, scene in scenes.items():
        there = on_gpu(scene)
        want, got = scene.render("cpu"), there.render("cuda")
        apart = (got.color.detach().cpu() - want.color.detach()).abs().amax(-1)
        weights = {k: w for k, w in cotangents(want, ignore=apart > IMAGE).items() if w.numel()}
        ours = gradients(there, "cuda", {k: w.cuda() for k, w in weights.items()})
        theirs = gradients(scene, "cpu", weights)
        worst = max((relative_l2(ours[k].cpu(), theirs[k]), k) for k in theirs)
        checks += [
            Check(
                f"{name}: share of pixels whose colour differs by more than {IMAGE:.0e}",
                float((apart > IMAGE).float().mean()),
                FLIPS,
                unit="",
            ),
            Check(f"{name}: worst gradient, relative L2", worst[0], GRADIENT, unit="", note=worst[1]),
        ]
        bench.tick(name)
    return Measured(f"backend cuda against backend cpu, float32 both; {gpu_name()}; {torch.get_num_threads()} threads of the CPU", checks)
