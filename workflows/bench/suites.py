"""The rows of each suite, in the order in which they are measured. Their modules, and torch, load when a row is measured."""

from __future__ import annotations

from importlib import import_module

from .rows import Bench, Measured, Row

REPEATS = {"raster": 7, "field": 15, "cuda": 15, "step": 15}  # of each contender, unless the command says otherwise
SECONDS = {"raster": 20.0, "field": 20.0, "cuda": 20.0, "step": 40.0}  # for the repeats of one contender


def row(name: str, what: str, module: str, function: str = "measure") -> Row:
    """A row that is measured by ``function`` of ``module`` (full name)."""

    def measure(bench: Bench) -> Measured:
        return getattr(import_module(module), function)(bench)

    return Row(name, what, measure)


RASTER, FIELD, CUDA, STEP = (f"{__package__}.{suite}" for suite in REPEATS)
SUITES: dict[str, list[Row]] = {
    "raster": [
        row("garden", "138,766 Gaussians at 648x420, on all threads and on one", RASTER, "garden_row"),
        row("convexes", "50,000 convexes at 648x420, on all threads and on one", RASTER, "convexes_row"),
    ],
    "field": [
        row("field", "the deformation field at 30,000 points, on all threads and on one", FIELD, "field_row"),
        row("loss", "L1 + SSIM at 400x400, on all threads and on one", FIELD, "loss_row"),
        row("adam", "the optimiser on 30,000 Gaussians, on all threads and on one", FIELD, "adam_row"),
    ],
    "cuda": [
        row("agreement", "images and gradients against the CPU kernels", f"{CUDA}.agreement"),
        row("step", "a whole training step, and rendering with deformation", f"{CUDA}.step"),
        row("determinism", "bit-equal sums over ten runs, and their cost", f"{CUDA}.determinism"),
        row("memory", "what does not fit is refused, and the process goes on", f"{CUDA}.memory"),
        row("first_use", "compiling all kernels, and a start from the cache", f"{CUDA}.first_use"),
    ],
    "step": [
        row(
            "motions",
            "a step on control nodes; with a rig as --capture, one on a rig, and what it saves that most of it is static",
            f"{STEP}.motions",
        ),
        row("split", "where the time of a step goes", f"{STEP}.split"),
    ],
}
