"""Checks of flow on a GPU, with Kornia: the same formulas as `two_way.consistency` and `edges.motion_boundaries`, which run on the CPU."""

from __future__ import annotations

import numpy as np
import torch
from kornia.filters import gaussian_blur2d, spatial_gradient
from torch import Tensor
from torch.nn import functional as F

from ..warp import sampled_tensor


def consistency(forward: np.ndarray, backward: np.ndarray, device: str) -> np.ndarray:
    """See `two_way.consistency`."""
    f, b = _plane(forward, device), _plane(backward, device)
    height, width = forward.shape[:2]
    x, y = f[0, 0] + torch.arange(width, device=device), f[0, 1] + torch.arange(height, device=device)[:, None]
    back = sampled_tensor(b, x, y)
    tolerance = 0.01 * (f.square() + back.square()).sum(1)[0] + 0.5
    weight = ((1 - (f + back).square().sum(1)[0] / tolerance) * (255 / 0.75)).nan_to_num(0).clamp(0, 255)
    outside = (x < 0) | (x > width - 1) | (y < 0) | (y > height - 1)
    return torch.where(outside, 0, weight).round().to(torch.uint8).cpu().numpy()


def motion_boundaries(flow: np.ndarray, confidence: np.ndarray, limits: tuple[float, float], device: str) -> np.ndarray:
    """See `edges.motion_boundaries`. In float64: a GPU may round the factors of a convolution of float32 to 10 bits (TF32)."""
    smooth = gaussian_blur2d(_plane(flow, device).double(), (9, 9), (1.0, 1.0), border_type="replicate")
    change = spatial_gradient(smooth)[0].square().sum((0, 1)).sqrt() / 0.3
    low, high = limits
    trusted = F.max_pool2d((_plane(confidence, device) == 255).float(), 3, 1, 1)[0, 0]
    weight = ((change - low) / (high - low)).nan_to_num(0).clamp(0, 1)
    return ((255 * weight).round() * trusted).to(torch.uint8).cpu().numpy()


def _plane(values: np.ndarray, device: str) -> Tensor:
    """[1, C, H, W] on ``device`` of ``values`` [H, W] or [H, W, C]."""
    return torch.from_numpy(values.reshape(*values.shape[:2], -1)).to(device).permute(2, 0, 1)[None]
