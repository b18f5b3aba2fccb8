"""Edge density under each Gaussian: the measure used to seed convexes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from ..rasterizer import rasterize
from .model import Model
from .views import Views


def edge_density(model: Model, views: Views, frames: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Mean edge weight [N] in [0, 1] over the pixels that each Gaussian contributes to, and its summed blending weight [N] in px, over
    ``frames``.

    Both come from the gradients of extra channels, as in `density.measure_responsibility`, so occluded Gaussians do not count.
    """
    total = torch.zeros(len(model.gaussians), 2, device=model.device)
    for i in frames:
        camera = views.rasterizer_camera(i)
        with torch.no_grad():
            gaussians, _ = model.at(float(views.time[i]), camera)
        probe = torch.zeros(len(model.gaussians), 2, device=model.device, requires_grad=True)
        frame = rasterize(camera, replace(gaussians, extras=probe), antialiased=model.antialiased)
        edges = views.edges(i)
        (frame.extras * torch.stack([torch.ones_like(edges), edges], -1)).sum().backward()
        if probe.grad is not None:
            total += probe.grad
    weight, edge = total.double().cpu().numpy().T
    return np.where(weight > 0, edge / np.maximum(weight, 1e-9), 0.0), weight
