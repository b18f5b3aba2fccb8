"""L1 + SSIM with separable convolutions in torch, as training with autograd has it."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

TAPS, SIGMA = 11, 1.5
C1, C2 = 0.01**2, 0.03**2


def torch_loss(
    image: Tensor,
    target: Tensor,
    l1: float = 0.8,
    ssim: float = 0.2,
    weight: Tensor | None = None,
    recording: tuple[Tensor, Tensor] | None = None,
) -> Tensor:
    """``l1 * mean|image - target| + ssim * (1 - SSIM)`` of [H, W, 3] images, in their precision. All pixels count alike: no ``weight``.
    recording: gain and offset [3] of the image."""
    if weight is not None:
        raise ValueError("the torch loss takes no weights of pixels")
    if recording is not None:
        image = recording[0] * image + recording[1]
    return l1 * (image - target).abs().mean() + ssim * (1 - torch_ssim(image, target))


def torch_ssim(x: Tensor, y: Tensor) -> Tensor:
    """Mean SSIM, zero padding. Moments of the target alone need no gradient and are blurred apart."""
    x, y = x.permute(2, 0, 1), y.permute(2, 0, 1)
    c = x.shape[0]
    mx, xx, xy = blur(torch.cat([x, x * x, x * y])).split(c)
    with torch.no_grad():
        my, yy = blur(torch.cat([y, y * y])).split(c)
    numerator = (2 * mx * my + C1) * (2 * (xy - mx * my) + C2)
    return (numerator / ((mx * mx + my * my + C1) * (xx - mx * mx + yy - my * my + C2))).mean()


def blur(planes: Tensor) -> Tensor:
    """[n, H, W] planes, each convolved with the Gaussian window along columns and then rows."""
    n = planes.shape[0]
    window = torch.exp(-(torch.arange(TAPS, dtype=planes.dtype) - TAPS // 2).square() / (2 * SIGMA**2))
    window = window / window.sum()
    planes = F.conv2d(planes[None], window.view(1, 1, 1, TAPS).expand(n, 1, 1, TAPS), padding=(0, TAPS // 2), groups=n)
    return F.conv2d(planes, window.view(1, 1, TAPS, 1).expand(n, 1, TAPS, 1), padding=(TAPS // 2, 0), groups=n)[0]
