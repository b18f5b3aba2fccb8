"""How much each Gaussian has to do with edges in the images, and how badly it shows them: where convexes are worth their cost."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch

from ...rasterizer import rasterize
from ...scene.model import Model
from ...scene.views import Views


class EdgeSeeds(NamedTuple):
    """For N Gaussians, over some views: weight [N], the sum of the blending weight, px. density [N] in [0, 1]: the mean edge weight of the
    pixels that each contributes to. error [N]: the sum of blending weight, edge weight and absolute error (mean over channels), px."""

    weight: np.ndarray
    density: np.ndarray
    error: np.ndarray


def edge_seeds(model: Model, views: Views, frames: list[int]) -> EdgeSeeds:
    """`EdgeSeeds` of the model's Gaussians over ``frames``.

    All come from the gradients of extra channels, as in `density.measure_responsibility`, so occluded Gaussians do not count.
    """
    total = torch.zeros(len(model.gaussians), 3, device=model.device)
    for i in frames:
        camera = views.rasterizer_camera(i)
        with torch.no_grad():
            gaussians, _ = model.at(views.moment(i), camera)
        probe = torch.zeros(len(model.gaussians), 3, device=model.device, requires_grad=True)
        background = torch.tensor(views.background)
        frame = rasterize(camera, replace(gaussians, extras=probe), background=background, antialiased=model.antialiased)
        edges = views.edges(i)
        with torch.no_grad():
            color = frame.color if model.affine is None else model.affine(frame.color, views.recorded_by(i))
            error = (color - views.target(i)).abs().mean(-1)
            kept = views.kept(i)
            if kept is not None:
                error = error * kept
        (frame.extras * torch.stack([torch.ones_like(edges), edges, edges * error], -1)).sum().backward()
        if probe.grad is not None:
            total += probe.grad
    weight, edge, error_sum = total.double().cpu().numpy().T
    return EdgeSeeds(weight, np.where(weight > 0, edge / np.maximum(weight, 1e-9), 0.0), error_sum)
