"""A weak penalty on opacity, as in 3DGS-MCMC: what is hidden behind surfaces fades, and is then removed."""

from typing import Any

from torch import Tensor

from .term import Rendered, Term


class Opacity(Term):
    """Sum over all primitives, in view or not, per pixel of the image: it does not depend on how many there are."""

    name = setting = "opacity"

    def value(self, rendered: Rendered, inputs: Any) -> Tensor:
        views = self.run.views
        return self.weight / (views.width * views.height) * (rendered.opacities.sum() + rendered.convexes.opacities.sum())
