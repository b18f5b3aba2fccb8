"""Both terms on the rendered depth, `depth_smoothness` and `depth_difference`, with their gradient from one fused kernel."""

from __future__ import annotations

import torch
from torch import Tensor

from .. import _kernels
from ..model import Model
from .depth_smoothness import depth_smoothness
from .measured_depth import depth_difference
from .photometric import scale_gradient
from .term import Now, Rendered, Term

SMOOTH_END = 0.05  # of its weight that the smoothness of surfaces has at the end: it helps to find them, then blurs their detail

Inputs = tuple[float | Tensor | None, Tensor | None, Tensor | None]


class Surface(Term):
    """`surface_loss`, scaled as means over the whole image, of which the frame may be a window."""

    name = "surface"

    def inputs(self, model: Model, now: Now) -> Inputs | None:
        """Weight of the smoothness, and measured depth and moving pixels, see `depth_difference`."""
        smooth = self.smooth(now.number) or None
        measured, moving = self._measured(now)
        return None if smooth is None and measured is None else (smooth, measured, moving)

    def value(self, rendered: Rendered, inputs: Inputs) -> Tensor:
        (smooth, measured, moving), frame, (whole_width, whole_height) = inputs, rendered.frame, rendered.size
        height, width = frame.depth.shape
        # `depth_smoothness` multiplies its mean by the width of what it gets.
        smooth = 0.0 if smooth is None else smooth * (height / whole_height)
        depth = self.run.settings.depth_weight * (height * width / (whole_height * whole_width))
        return surface_loss(frame.depth, frame.alpha, rendered.target, self.run.unit, smooth, depth, measured, moving, rendered.weight)

    def smooth(self, step: int) -> float:
        """Weight of the smoothness of surfaces at ``step``; 0 unless one time alone shows the scene from several sides."""
        return self.run.settings.smooth_weight * SMOOTH_END ** self.run.progress(step) if self.run.several else 0.0

    def _measured(self, now: Now) -> tuple[Tensor | None, Tensor | None]:
        known, views = self.run.measured.depth, self.run.views
        if known is None or not self.run.settings.depth_weight:
            return None, None
        width, height = views.size(now.scale)
        if now.window is None and views.device == "cpu":
            return known.of(now.frame, height, width), known.moving(now.frame)
        # What moves has depth 0 there, where it is unknown: some frames have no mask, and graphs of both kinds would be one too many.
        whole = known.static(now.frame, height, width)
        if whole is None or now.window is None:
            return whole, None
        left, top, right, bottom = now.window
        return whole[top:bottom, left:right], None


def surface_loss(
    depth: Tensor,
    alpha: Tensor,
    image: Tensor,
    unit: float,
    smooth: float | Tensor,
    measure: float = 0.0,
    measured: Tensor | None = None,
    moving: Tensor | None = None,
    weight: Tensor | None = None,
) -> Tensor:
    """``smooth`` times `depth_smoothness`, plus ``measure`` times `depth_difference` if ``measured`` is given: a scalar.

    smooth: a number, or a tensor [] on the device.
    weight: [H, W] float32, factor on each pixel's gradient, but not on its loss; None: 1 everywhere. For the rest, see the two terms.
    Off the CPU and in double, where it is the kernel's oracle, the terms are computed with torch.
    """
    if depth.device.type == "cpu" and depth.dtype == torch.float32:
        return _Surface.apply(depth, alpha, image, measured, moving, weight, unit, float(smooth), measure)
    if weight is not None:
        depth, alpha = scale_gradient(depth, weight), scale_gradient(alpha, weight)
    # Not asked of a tensor, which would wait for a GPU.
    smoothed = isinstance(smooth, Tensor) or smooth > 0
    loss = smooth * depth_smoothness(depth, alpha, image, unit) if smoothed else depth.new_zeros(())
    return loss if measured is None else loss + measure * depth_difference(depth, alpha, measured, moving, unit)


class _Surface(torch.autograd.Function):
    @staticmethod
    def forward(ctx, depth, alpha, image, measured, moving, weight, unit, smooth, measure):  # type: ignore[override]
        plain = [None if t is None else t.detach().contiguous() for t in (depth, alpha, image, measured, moving, weight)]
        grads = torch.empty(2, *depth.shape)
        loss = _kernels.surface(*plain, unit, smooth, measure, grads[0], grads[1], torch.get_num_threads())
        ctx.save_for_backward(grads)
        return depth.new_tensor(loss)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, grad_output: Tensor):  # type: ignore[override]
        (grads,) = ctx.saved_tensors
        d_depth, d_alpha = grads if float(grad_output) == 1.0 else grads * grad_output
        return d_depth, d_alpha, *([None] * 7)
