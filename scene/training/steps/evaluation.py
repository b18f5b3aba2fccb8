"""What the objective finds at one step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ...losses.photometric import Recording
from ...metrics.psnr import decibels
from ..optimiser import ALL_ROWS, Rows


@dataclass(eq=False)
class Evaluation:
    loss: Tensor  # what is minimised
    image_loss: Tensor  # the part of it that compares images, detached
    color: Tensor  # [h, w, 3] as rendered, before the camera records it
    target: Tensor  # [h, w, 3]
    weight: Tensor | None  # [h, w] of the pixels' gradients, 0 for those that do not count; None: 1 everywhere
    recording: Recording | None
    rows: Rows = ALL_ROWS  # copies of the Gaussians that the view may show, which get the gradients
    gradients: Sequence[tuple[Tensor, Tensor]] | None = None  # parameters and their gradients, if these are known already

    def backward(self) -> None:
        """Leave the gradients of the loss with the parameters."""
        if self.gradients is None:
            # In this thread: for a GPU, autograd would otherwise wake another one and wait for it.
            with torch.autograd.set_multithreading_enabled(False):
                self.loss.backward()  # type: ignore[no-untyped-call]
        else:
            for parameter, gradient in self.gradients:
                parameter.grad = gradient

    def psnr(self) -> float:
        """PSNR in dB over the pixels that count, or over all if none does."""
        color = self.color.detach()
        if self.recording is not None:
            color = self.recording[0].detach() * color + self.recording[1].detach()
        error = (color - self.target).square().mean(-1)
        if self.weight is not None and bool(self.weight.any()):
            error = error[self.weight != 0]
        return decibels(float(error.mean()))
