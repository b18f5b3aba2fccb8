"""Which Gaussians one view may show: a training step computes only with these, so that the rest of the scene costs nothing."""

from __future__ import annotations

import torch
from torch import Tensor

from ...rasterizer import TILE, Camera
from .. import _kernels
from ..primitives import GaussianSet


def in_view(gaussians: GaussianSet, camera: Camera, frame: float | None = None, tiles: Tensor | None = None, fuller: float = 1.0) -> Tensor:
    """[m] int64, ascending: every one of the N ``gaussians`` that can contribute to a drawn pixel of ``camera``, and some that do not.

    ``frame``: the fractional frame number of `Lifetimes`, at which they are where their life puts them, and as opaque; None: nothing
    moves. ``tiles`` [rows, columns] bool, as `rasterize` takes them. ``fuller``: they will be drawn at most so many times as opaque.
    Everything is on the CPU; no gradients.
    """
    g = gaussians
    life = [] if frame is None else [g.times, g.log_spans, g.velocities]
    means, log_scales, logits, *life = (p.detach() for p in (g.means, g.log_scales, g.opacity_logits, *life))
    k, pose = camera.K.detach().double(), camera.cam_from_world.detach().double()
    pinhole = torch.stack([k[0, 0], k[1, 1], k[0, 2], k[1, 2], k.new_tensor(camera.near)])
    index = torch.empty(len(g), dtype=torch.int64)
    found = _kernels.in_view(
        means,
        log_scales,
        logits,
        life,
        g.dynamic,
        0.0 if frame is None else frame,
        fuller,
        torch.cat([pinhole, pose[:3].flatten()]),
        camera.width,
        camera.height,
        tiles,
        TILE,
        index,
        torch.get_num_threads(),
    )
    return index[:found]
