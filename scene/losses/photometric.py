"""The image terms of Eq. 9, L1 and 1 - SSIM, with their gradient from one fused kernel."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from .. import _kernels

Recording = tuple[Tensor, Tensor]  # gain, offset [3]


def photometric_loss(
    image: Tensor, target: Tensor, l1: float = 0.8, ssim: float = 0.2, weight: Tensor | None = None, recording: Recording | None = None
) -> Tensor:
    """``l1 * mean|recorded - target| + ssim * (1 - SSIM(recorded, target))``, a scalar, where recorded is ``gain * image + offset``.

    Args:
        image: [H, W, 3] float32, receives gradients. If it is on a CUDA device, so is the loss, and the call does not synchronise.
        target: [H, W, 3] float32, receives none.
        l1, ssim: the weights lambda_1 and lambda_2 of Eq. 9.
        weight: [H, W] float32, factor on each pixel's gradient, but not on its loss; where it is 0, the pixel counts as equal to the
            target. None: 1 everywhere.
        recording: gain and offset, [3] float32 each: how the camera records colours. Both receive gradients. None: 1 and 0.
    """
    if image.shape != target.shape or image.ndim != 3 or image.shape[2] != 3:
        raise ValueError(f"image and target must both be [H, W, 3]; got {tuple(image.shape)} and {tuple(target.shape)}")
    if weight is not None and weight.shape != image.shape[:2]:
        raise ValueError(f"weight must be {list(image.shape[:2])}, got {list(weight.shape)}")
    if image.device.type == "cpu" and image.dtype == torch.float32:
        return _Photometric.apply(image, target, l1, ssim, weight, *(recording or (None, None)))
    if image.device.type == "cuda" and image.dtype == torch.float32:
        from ...rasterizer.cuda.runtime import launcher_for
        from ..cuda import photometric

        return photometric.photometric_loss(launcher_for(image.device), image, target, l1, ssim, weight, recording)
    if recording is not None:
        image = recording[0] * image + recording[1]
    if weight is not None:
        image = scale_gradient(torch.where(weight[..., None] != 0, image, target), weight[..., None])
    return l1 * (image - target).abs().mean() + ssim * (1 - ssim_reference(image, target))


def ssim_reference(x: Tensor, y: Tensor) -> Tensor:
    """Mean SSIM of two [H, W, C] images in [0, 1]: 11-tap Gaussian window, sigma 1.5, zero padding. Plain torch: the kernel's oracle."""
    window = torch.exp(-torch.arange(-5, 6, dtype=x.dtype, device=x.device).square() / (2 * 1.5**2))
    window = window / window.sum()
    c = x.shape[2]
    moments = torch.cat([x, y, x * x, y * y, x * y], dim=2).permute(2, 0, 1)[None]
    moments = F.conv2d(moments, window.view(1, 1, 1, 11).expand(5 * c, 1, 1, 11), padding=(0, 5), groups=5 * c)
    moments = F.conv2d(moments, window.view(1, 1, 11, 1).expand(5 * c, 1, 11, 1), padding=(5, 0), groups=5 * c)
    mx, my, xx, yy, xy = moments[0].split(c)
    c1, c2 = 0.01**2, 0.03**2
    numerator = (2 * mx * my + c1) * (2 * (xy - mx * my) + c2)
    return (numerator / ((mx * mx + my * my + c1) * (xx - mx * mx + yy - my * my + c2))).mean()


def scale_gradient(x: Tensor, weight: Tensor) -> Tensor:
    """``x``, whose gradient is multiplied by ``weight``, of a shape that broadcasts to that of ``x``."""
    return _Scaled.apply(x, weight)


class _Scaled(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x: Tensor, weight: Tensor) -> Tensor:  # type: ignore[override]
        ctx.save_for_backward(weight)
        return x.view_as(x)

    @staticmethod
    def backward(ctx, grad: Tensor):  # type: ignore[override]
        return grad * ctx.saved_tensors[0], None


class _Photometric(torch.autograd.Function):
    @staticmethod
    def forward(ctx, image, target, l1, ssim, weight, gain, offset) -> Tensor:  # type: ignore[override]
        grad = torch.empty_like(image, memory_format=torch.contiguous_format)
        d_gain, d_offset = image.new_empty(3), image.new_empty(3)
        x, y, *others = (None if given is None else given.detach().contiguous() for given in (image, target, weight, gain, offset))
        mean_l1, mean_ssim = _kernels.photometric(x, y, *others, l1, ssim, grad, d_gain, d_offset, torch.get_num_threads())
        ctx.save_for_backward(grad, d_gain, d_offset)
        return image.new_tensor(l1 * mean_l1 + ssim * (1.0 - mean_ssim))

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, grad_output: Tensor):  # type: ignore[override]
        scale = float(grad_output)
        image, gain, offset = (grad if scale == 1.0 else grad * scale for grad in ctx.saved_tensors)
        return image, None, None, None, None, *((gain, offset) if ctx.needs_input_grad[5] else (None, None))
