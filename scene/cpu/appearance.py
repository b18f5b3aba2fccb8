"""The image terms in front of two backgrounds, and the L1 of alpha, with their gradient from one kernel on the CPU."""

from __future__ import annotations

import torch
from torch import Tensor

from .. import _kernels
from ..cuda.opposite import Opposite


def two_backgrounds_loss(
    image: Tensor,
    target: Tensor,
    l1: float,
    ssim: float,
    weight: Tensor | None,
    recording: tuple[Tensor, Tensor] | None,
    opposite: Opposite,
) -> Tensor:
    """(1 - share) of `losses.photometric.photometric_loss`, share of the same in front of the ``opposite`` background, and the L1 of
    alpha: a scalar. The other arguments are those of that function; all are float32 on the CPU."""
    return _TwoBackgrounds.apply(image, opposite.alpha, target, l1, ssim, weight, *(recording or (None, None)), *opposite[1:])


class _TwoBackgrounds(torch.autograd.Function):
    @staticmethod
    def forward(ctx, image, alpha, target, l1, ssim, weight, gain, offset, known, kept, change, share, of_alpha):  # type: ignore[override]
        shown, alpha = image.detach().contiguous(), alpha.detach().contiguous()
        grads = torch.empty_like(shown), torch.empty_like(alpha), image.new_empty(3), image.new_empty(3)
        target, weight, gain, offset, known, kept = (
            None if given is None else given.detach().contiguous() for given in (target, weight, gain, offset, known, kept)
        )
        given = shown, target, weight, gain, offset, l1, ssim, alpha, known, kept, change, share, of_alpha
        loss = _kernels.appearance(*given, *grads, torch.get_num_threads())
        ctx.save_for_backward(*grads)
        return image.new_tensor(loss)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, grad_output: Tensor):  # type: ignore[override]
        scale = float(grad_output)
        image, alpha, gain, offset = (grad if scale == 1.0 else grad * scale for grad in ctx.saved_tensors)
        recording = (gain, offset) if ctx.needs_input_grad[6] else (None, None)
        return image, alpha, None, None, None, None, *recording, None, None, None, None, None
