"""The image terms of the loss and their gradient on the GPU: a torch.autograd.Function around two kernels."""

from __future__ import annotations

from ctypes import c_float, c_int32
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ...rasterizer.cuda.runtime import Launcher
from .programs import program

WIDE, HIGH = 32, 8  # px, size of a tile
THREADS = 192


def photometric_loss(launcher: Launcher, image: Tensor, target: Tensor, l1: float, ssim: float) -> Tensor:
    """``l1 * mean|image - target| + ssim * (1 - SSIM)``, a scalar on the launcher's device. The call does not synchronise.

    image, target: [H, W, 3] float32. Gradients go to image only and are bit-equal from run to run.

    Raises ValueError for other shapes or types and for images without pixels, and whatever `Launcher.launch` raises.
    """
    if image.shape != target.shape or image.ndim != 3 or image.shape[2] != 3 or not image.numel():
        raise ValueError(f"image and target must both be [H, W, 3]; got {tuple(image.shape)} and {tuple(target.shape)}")
    if image.dtype != torch.float32 or target.dtype != torch.float32:
        raise ValueError(f"image and target must be float32; got {image.dtype} and {target.dtype}")
    loss: Tensor = _Photometric.apply(launcher, image, target, l1, ssim)
    return loss


class _Photometric(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, launcher: Launcher, image: Tensor, target: Tensor, l1: float, ssim: float) -> Tensor:
        image, target = image.detach().contiguous(), target.detach().contiguous()
        height, width = image.shape[:2]
        pitch = -(-width // 4) * 4
        maps = image.new_empty(3, 3, height, pitch) if ctx.needs_input_grad[1] else None
        blocks = -(-width // WIDE) * -(-height // HIGH)
        losses = image.new_empty(blocks)
        scalars = (c_int32(width), c_int32(height), c_int32(pitch), c_float(l1 / image.numel()), c_float(ssim / image.numel()))
        launcher.launch(program("photometric"), "photometric_loss", blocks, THREADS, image, target, *scalars, maps, losses)
        if maps is not None:
            ctx.launcher, ctx.blocks, ctx.scalars = launcher, blocks, scalars
            ctx.save_for_backward(image, target, maps)
        return losses.sum()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Any, ...]:
        image, target, maps = ctx.saved_tensors
        gradient = torch.empty_like(image)
        inputs = (image, target, maps, upstream.contiguous(), *ctx.scalars)
        ctx.launcher.launch(program("photometric"), "photometric_gradient", ctx.blocks, THREADS, *inputs, gradient)
        return None, gradient, None, None, None
