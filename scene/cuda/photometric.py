"""The image terms of the loss and their gradients on the GPU: a torch.autograd.Function around two kernels."""

from __future__ import annotations

from ctypes import c_float, c_int32
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ...rasterizer.cuda.runtime import Launcher
from .inputs import check
from .opposite import Opposite
from .programs import program

WIDE, HIGH = 32, 8  # px, size of a tile
THREADS = 192


def photometric_loss(
    launcher: Launcher,
    image: Tensor,
    target: Tensor,
    l1: float,
    ssim: float,
    weight: Tensor | None = None,
    recording: tuple[Tensor, Tensor] | None = None,
    opposite: Opposite | None = None,
) -> Tensor:
    """`scene.losses.photometric.photometric_loss` and, with ``opposite``, `scene.losses.appearance.appearance_loss`: a scalar on the
    launcher's device. The call does not synchronise.

    image, target: [H, W, 3] float32. weight: [H, W] float32. recording: gain and offset, [3] float32 each. Gradients go to image, recording
    and the rendered alpha, and are bit-equal from run to run.

    Raises ValueError for other shapes or types and for images without pixels, and whatever `Launcher.launch` raises.
    """
    if image.shape != target.shape or image.ndim != 3 or image.shape[2] != 3 or not image.numel():
        raise ValueError(f"image and target must both be [H, W, 3]; got {tuple(image.shape)} and {tuple(target.shape)}")
    gain, offset = recording or (None, None)
    alpha, known, kept = opposite[:3] if opposite else (None, None, None)
    size = image.shape[:2]
    given = {"image": (image, (*size, 3)), "target": (target, (*size, 3)), "weight": (weight, size), "gain": (gain, (3,))}
    given |= {"offset": (offset, (3,)), "alpha": (alpha, size), "known": (known, size), "kept": (kept, size)}
    check(given, kept=torch.bool)
    pixels = size.numel()
    share, of_alpha, change = (opposite.share, opposite.weight, opposite.change) if opposite else (0.0, 0.0, (0.0, 0.0, 0.0))
    weights = [part * term / (3 * pixels) for part in (1 - share, share) for term in (l1, ssim)]
    loss: Tensor = _Photometric.apply(launcher, change, (*weights, of_alpha / pixels), *(tensor for tensor, _ in given.values()))
    return loss


class _Photometric(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, launcher: Launcher, change: tuple[float, ...], weights: tuple[float, ...], *given: Tensor | None) -> Tensor:
        inputs = [None if p is None else p.detach().contiguous() for p in given]
        image, _, _, _, _, alpha, *_ = inputs
        assert image is not None
        height, width = image.shape[:2]
        pitch, backgrounds = -(-width // 4) * 4, 1 if alpha is None else 2
        maps = image.new_empty(backgrounds, 3, 3, height, pitch) if any(ctx.needs_input_grad) else None
        tiles = -(-width // WIDE) * -(-height // HIGH)
        losses = image.new_empty(backgrounds * tiles)
        scalars: tuple[c_float | c_int32, ...] = (*map(c_float, change), *map(c_int32, (width, height, pitch)), *map(c_float, weights))
        launcher.launch(program("photometric"), "photometric_loss", len(losses), THREADS, *inputs, *scalars, maps, losses)
        ctx.launcher, ctx.tiles, ctx.scalars = launcher, tiles, scalars
        ctx.save_for_backward(*inputs, maps)
        return losses.sum()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Any, ...]:
        *inputs, maps = ctx.saved_tensors
        image, _, _, gain, _, alpha, *_ = inputs
        d_image, d_alpha = torch.empty_like(image), None if alpha is None else torch.empty_like(alpha)
        d_recording = None if gain is None else image.new_empty(ctx.tiles, 6)
        given, results = (*inputs, *ctx.scalars, maps, upstream.contiguous()), (d_image, d_alpha, d_recording)
        ctx.launcher.launch(program("photometric"), "photometric_gradient", ctx.tiles, THREADS, *given, *results)
        d_gain, d_offset = (None, None) if d_recording is None else d_recording.sum(0).view(2, 3)
        return None, None, None, d_image, None, None, d_gain, d_offset, d_alpha, None, None
