"""The objective of a step that is captured as a CUDA graph."""

from __future__ import annotations

from copy import copy

from torch import Tensor

from ...colour import CameraAffine
from ...model import Model
from ...views import Window
from ..drawn_tiles import Drawn
from ..objective import Now, Objective
from .one_view import OneView


class OfOneView(Objective):
    """``objective`` for whatever frame and step ``view`` shows."""

    def __init__(self, objective: Objective, view: OneView) -> None:
        self.__dict__.update(vars(objective))
        self.view = self.views = view  # type: ignore[assignment]
        self.motion_terms = copy(objective.motion_terms)
        self.motion_terms.views, self.motion_terms.flow_target = view, view.flow_target  # type: ignore[assignment,method-assign]

    def relink(self, model: Model, step: int) -> None:
        """Not in the graph: the search comes before the replay, which finds the new links in the place of the old ones."""

    def now(self, step: int) -> Now:
        return self.view.now()

    def drawn_of(self, i: int, scale: float, step: int) -> Drawn | None:
        return self.view.drawn()

    def row(self, affine: CameraAffine | None, i: int) -> Tensor | None:
        return self.view.row()

    def measured(self, i: int, height: int, width: int) -> tuple[Tensor | None, None]:
        return self.view.measured(), None

    def held(self, i: int, scale: float, step: int, window: Window | None = None) -> Tensor | None:
        return self.view.held()
