"""A weak penalty on opacity, as in 3DGS-MCMC: what is hidden behind surfaces fades, and is then removed."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from .term import Rendered, Run, Term


class Opacity(Term):
    """Sum over all primitives, in view or not, per pixel of the image: it does not depend on how many there are."""

    name = "opacity"

    def __init__(self, run: Run) -> None:
        super().__init__(run)
        self.weight = run.weight("opacity") / (run.views.width * run.views.height)

    def value(self, rendered: Rendered, inputs: Any) -> Tensor:
        return self.weight * (rendered.opacities.sum() + rendered.convexes.opacities.sum())
