"""Arrays sampled where flow leads: by OpenCV on the CPU, by Kornia on a GPU.

On one core Kornia takes 2 times as long to warp and 75 times to blur, and its last bits differ: OpenCV rounds places to 1/32 px.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from torch import Tensor


def warped(values: np.ndarray, flow: np.ndarray, device: str = "cpu") -> np.ndarray:
    """``values`` [H, W] or [H, W, C], uint8 or float32, at the place to which ``flow`` [H, W, 2] px moves each pixel: see `sampled`."""
    return sampled(values, *places(flow), device)


def places(flow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """x and y, float32 [H, W] px each, counted from the centre of the first pixel, to which ``flow`` [H, W, 2] px moves each pixel."""
    height, width = flow.shape[:2]
    return flow[..., 0] + np.arange(width, dtype=np.float32), flow[..., 1] + np.arange(height, dtype=np.float32)[:, None]


def sampled(values: np.ndarray, x: np.ndarray, y: np.ndarray, device: str = "cpu") -> np.ndarray:
    """``values`` [H, W] or [H, W, C], uint8 or float32, at the places ``x`` and ``y`` [h, w] px, bilinear. The border goes on outside."""
    if device == "cpu":
        import cv2

        return cv2.remap(values, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    import torch

    plane = torch.from_numpy(values.reshape(*values.shape[:2], -1)).to(device).permute(2, 0, 1)[None].float()
    found = sampled_tensor(plane, *(torch.from_numpy(place).to(device) for place in (x, y)))[0].permute(1, 2, 0)
    found = found.round().to(torch.uint8) if values.dtype == np.uint8 else found
    return found.reshape(*x.shape, *values.shape[2:]).cpu().numpy()


def sampled_tensor(values: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """The same of tensors: ``values`` [1, C, H, W] at ``x`` and ``y`` [h, w]; [1, C, h, w]."""
    from kornia.geometry.transform import remap

    # Kornia's range: from -1 at the centre of the first pixel to 1 at that of the last.
    x, y = (2 / max(size - 1, 1) * place[None] - 1 for place, size in ((x, values.shape[3]), (y, values.shape[2])))
    return remap(values, x, y, padding_mode="border", align_corners=True, normalized_coordinates=True)
