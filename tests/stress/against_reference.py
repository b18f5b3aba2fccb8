"""The CPU kernels held against the float64 reference on the same float32 numbers, with the tolerances that the rasterizer promises."""

from __future__ import annotations

import torch
from e4dgs.rasterizer import Frame
from rasterizer.compare import OUTPUTS, assert_gradients_close, assert_images_close, cotangents, decided_by_threshold, gradients
from rasterizer.scenes import Scene
from torch import Tensor

IMAGE = 2e-5  # largest difference outside pixels that a threshold decides
GRADIENT = 1e-4  # relative L2


def check(scene: Scene, max_decided: float = 0.05, outputs: tuple[str, ...] = OUTPUTS, max_flips: float = 0.01, **bands: float) -> Frame:
    """Image, and gradients with respect to every input of a random weighting of `outputs`. Returns the kernels' frame."""
    single = scene.to(torch.float32)
    got, want = single.render("cpu"), single.render("reference")
    decided = decided_by_threshold(single, **bands)
    assert_images_close(got, want, decided, tolerance=IMAGE, max_decided=max_decided, max_flips=max_flips)
    weights = cotangents(want, ignore=decided, outputs=outputs)
    check_gradients(single, weights)
    return got


def check_gradients(single: Scene, weights: dict[str, Tensor], names: tuple[str, ...] | None = None) -> None:
    """Gradients of this weighting with respect to the inputs `names` (all)."""
    got, want = gradients(single, "cpu", weights), gradients(single, "reference", weights)
    names = names or tuple(want)
    assert_gradients_close({n: got[n] for n in names}, {n: want[n] for n in names}, relative=GRADIENT)
