"""Which primitives are dynamic: static ones leave the deformation field, where most of the time of a step is spent."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
import torch
from torch import Tensor

from ...model import Model
from ...motion.nodes.skinning import distances
from ...views import Views, inside_image

TIMES = 12  # times sampled over the capture to measure how far a primitive travels
MOVING_SHARE = 0.5  # of the looks at a place; if so many show something moving there, what is at rest may have to look different over time
STATIC_PIXELS = 0.3  # primitives that travel less than this, seen from the nearest training camera, are static


def mean_path(model: Model, index: Tensor) -> tuple[Tensor, Tensor]:
    """Mean displacement [m, 3] of the Gaussians ``index`` over the capture and the largest distance from it [m], world units."""
    with torch.no_grad():
        rest = model.gaussians.means[index]
        paths = torch.stack([model.carried(index, float(t)).points - rest for t in np.linspace(0, 1, TIMES)])
    mean = paths.mean(0)
    return mean, (paths - mean).norm(dim=2).amax(0)


def freeze_static_gaussians(model: Model, views: Views, pixels: float = STATIC_PIXELS, share: float = 0.0) -> int:
    """Take Gaussians that travel less than ``pixels`` out of the field and fix them at their mean position, as turned and as large as in
    the middle of the capture. If they are less than ``share`` of those in the field, none leaves, because selecting the others would cost
    more than it saves. Returns how many left."""
    index = model.gaussians.dynamic.nonzero()[:, 0]
    if model.motion.static or not len(index):
        return 0
    mean, travel = mean_path(model, index)
    centres = torch.tensor(views.centres()[views.train], dtype=torch.float32, device=model.device)
    with torch.no_grad():
        nearest = distances(model.gaussians.means[index], centres).amin(1)
    focal = float(views.K[views.train, 0, 0].max())
    static = travel * focal / nearest.clamp(min=views.near) < pixels
    if float(static.float().mean()) < share:
        return 0
    bake(model, mean[static], index[static], t=0.5)
    return int(static.sum())


def bake(model: Model, displacement: Tensor, index: Tensor, t: float) -> None:
    """Take the Gaussians ``index`` out of the motion: their rest positions move by ``displacement`` [m, 3], and they keep the orientation
    and the size that the motion gives them at time ``t``."""
    g = model.gaussians
    with torch.no_grad():
        moved = model.carried(index, t)
        g.means[index] += displacement
        g.quats[index] = moved.quats
        if moved.log_scales is not None:
            g.log_scales[index] += moved.log_scales
    g.dynamic[index] = False


def dynamic_from_masks(points: np.ndarray, views: Views, looks: Iterable[tuple[int, np.ndarray]], share: float) -> np.ndarray:
    """Which of ``points`` [P, 3] may move, as [P] bool: those on moving pixels in at least ``share`` of the looks that see them.

    looks: pairs of a frame number and a mask [H, W] uint8, 255 for moving pixels. A point that no look sees counts as dynamic.
    """
    seen = np.zeros(len(points))
    moving = np.zeros(len(points))
    for i, mask in looks:
        shown, x, y, _ = views.project(i, points)
        seen[shown] += 1
        moving[shown] += mask[y, x] > 127
    return (seen == 0) | (moving >= share * np.maximum(seen, 1))


def on_moving_pixels(
    centres: Tensor, views: Views, frames: Sequence[int], moving: Callable[[int], Tensor | None], share: float = MOVING_SHARE
) -> Tensor:
    """Which of the ``centres`` [N, 3] (world units) at rest lie on moving pixels in at least ``share`` of those ``frames`` that show them,
    as [N] bool. What no frame shows does not.

    moving(i): [h, w] bool of any size, the moving pixels of frame i; None if there are none.
    """
    seen, found = torch.zeros(len(centres), device=centres.device), torch.zeros(len(centres), device=centres.device)
    for i in frames:
        camera = views.rasterizer_camera(i)
        shown = inside_image(camera, centres)
        seen += shown
        mask = moving(i)
        if mask is None:
            continue
        R, T, K = (part.to(centres) for part in (camera.cam_from_world[:3, :3], camera.cam_from_world[:3, 3], camera.K))
        cam = centres @ R.T + T
        at = (cam[:, :2] / cam[:, 2:].clamp(min=camera.near)) * K.diagonal()[:2] + K[:2, 2]
        size = at.new_tensor([mask.shape[1] / camera.width, mask.shape[0] / camera.height])
        x, y = ((at * size)[:, c].long().clamp(0, mask.shape[1 - c] - 1) for c in (0, 1))
        found += shown & mask[y, x]
    return (seen > 0) & (found >= share * seen)
