"""Scenes that benchmarks alone measure on."""

from __future__ import annotations

import numpy as np
import torch
from e4dgs.rasterizer import Convexes
from e4dgs.rasterizer.reference.scene import Scene
from e4dgs.workflows.bench.scenes import SEED, camera_of, tensor


def reconstructed_convexes(m: int, width: int, height: int) -> Scene:
    """``m`` convexes as a reconstruction has them: on a surface, sizes spread over a decade, a third of them sharp and opaque, the rest as
    soft as they are when training begins (tau r = 20, kappa r = 12 for a convex of radius r)."""
    rng = np.random.default_rng(SEED)
    centres = rng.standard_normal((m, 1, 3))
    centres /= np.linalg.norm(centres, axis=2, keepdims=True)
    radius = np.exp(rng.normal(np.log(0.03), 0.6, (m, 1, 1)))
    directions = rng.standard_normal((m, 6, 3))
    points = centres + radius * directions / np.linalg.norm(directions, axis=2, keepdims=True) * rng.uniform(0.6, 1, (m, 6, 1))
    sharp = rng.uniform(0, 1, m) < 1 / 3
    tau = np.where(sharp, rng.uniform(40, 150, m), rng.uniform(10, 30, m)) / radius[:, 0, 0]
    kappa = np.where(sharp, rng.uniform(30, 150, m), rng.uniform(6, 20, m)) / radius[:, 0, 0]
    opacities = np.where(sharp, rng.uniform(0.6, 1, m), rng.uniform(0.05, 0.6, m))
    colors = rng.uniform(0, 1, (m, 3))
    shapes = Convexes(tensor(points), tensor(tau), tensor(kappa), tensor(opacities), colors=tensor(colors))
    return Scene(camera_of(width, height), None, shapes, torch.zeros(3))
