"""The rows of each suite, in the order in which they are measured. Their modules, and torch, load when a row is measured."""

from __future__ import annotations

from importlib import import_module

from .rows import Bench, Measured, Row


def _row(suite: str, name: str, what: str, optional: bool = False) -> Row:
    def measure(bench: Bench) -> Measured:
        return import_module(f".{suite}.{name}", __package__).measure(bench)

    return Row(name, what, measure, optional)


SUITES: dict[str, list[Row]] = {
    "raster": [
        _row("raster", "garden", "138,766 Gaussians at 648x420 against the pure blend limit of this processor"),
        _row("raster", "torch", "the same scene against a tile rasterizer in plain torch"),
        _row("raster", "convexes", "cost of a (pixel, convex) pair against that of a (pixel, Gaussian) pair"),
        _row("raster", "memory", "peak memory of a million Gaussians at 1920x1080, and what is too large for this machine"),
        _row("raster", "determinism", "image and gradients over numbers of threads and runs, bit by bit"),
        _row("raster", "accuracy", "image and gradients against the float64 reference"),
        _row("raster", "scaling", "time over primitives, pixels and threads"),
        _row("raster", "knobs", "time and error for what can be turned at run time: instruction set, SH degree"),
    ],
    "field": [
        _row("field", "field", "the deformation field at 30,000 points against its composition of torch operations"),
        _row("field", "loss", "L1 + SSIM at 400x400 against separable convolutions in torch"),
        _row("field", "adam", "the optimiser on 30,000 Gaussians against torch's foreach and fused Adam"),
    ],
    "cuda": [
        _row("cuda", "agreement", "images and gradients against the CPU kernels"),
        _row("cuda", "gsplat", "time and memory beside gsplat on its garden scene, tiled 1, 4 and 16 times, at two sizes"),
        _row("cuda", "convexes", "cost of a (pixel, convex) pair against that of a (pixel, Gaussian) pair"),
        _row("cuda", "step", "a whole training step, and rendering with deformation"),
        _row("cuda", "determinism", "bit-equal sums over ten runs, and their cost"),
        _row("cuda", "memory", "what does not fit is refused, and the process goes on"),
        _row("cuda", "first_use", "compiling all kernels, and a start from the cache"),
    ],
    "step": [
        _row("step", "step", "a whole training step on 30,000 Gaussians against the same step composed of torch operations"),
        _row("step", "motions", "a step on control nodes; with a rig as --capture, one on a rig, and what it saves that most stands still"),
        _row("step", "split", "where the time of our step goes"),
    ],
}
