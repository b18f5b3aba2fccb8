"""The term that holds what moves before one camera where the capture's own depth shows it."""

from __future__ import annotations

from torch import Tensor

from ..model import Model
from .held_depth import held_depth_difference
from .term import Now, Rendered, Term


class MovingDepth(Term):
    """`held_depth_difference`, scaled as a mean over the whole image, of which the frame may be a window."""

    name, setting = "moving depth", "depth"

    def due(self, model: Model, now: Now) -> bool:
        return super().due(model, now) and self.run.measured.held is not None

    def inputs(self, model: Model, now: Now) -> tuple[Tensor] | None:
        """See `HeldDepth.of`; None where nothing is held."""
        if self.run.measured.held is None:
            return None
        width, height = self.run.views.size(now.scale)
        held = self.run.measured.held.of(now.frame, height, width)
        if held is not None and now.window is not None:
            left, top, right, bottom = now.window
            held = held[:, top:bottom, left:right]
        return None if held is None else (held,)

    def value(self, rendered: Rendered, inputs: tuple[Tensor]) -> Tensor:
        frame = rendered.frame
        return self.weight * rendered.share * held_depth_difference(frame.depth, frame.alpha, *inputs, self.run.unit, rendered.weight)
