"""What control nodes go through during training: a window of times, then more nodes and keys, and bodies for what turns."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from ..model import Model
from ..motion.nodes import ControlNodes, farthest_points
from ..views import Views
from .density import measure_responsibility
from .turning import bodies_for_turning_parts

# Fractions of the stage's steps, unless they say otherwise.
OPEN = 0.21  # nodes have seen all times by then
START = 0.04  # of the times, to either side of the middle one: where they begin
SETTLE = 0.02  # between the last time's coming in and the search for turning parts
HOLD = 0.07  # motion waits while a new body takes its colours
FREEZE_AT = 0.57  # what nodes hold still leaves them; it has been seen at a quarter of the size by then
NODES = 128  # once all times are in
SOLID = 0.2  # opacity of Gaussians among which nodes are spread then


class NodeTraining:
    """Progress of one training run of ``total`` steps over captured ``times`` [n] with nodes. ``seed`` for what is sampled."""

    def __init__(self, total: int, times: np.ndarray, seed: int) -> None:
        self.total, self.seed = total, seed
        self.opened = round(OPEN * total)
        self.start = max(2, round(START * len(np.unique(times))))
        self.searched = False
        self.hold_until = 0

    def due(self, iteration: int) -> bool:
        """All times have been in for a while and the nodes have not been renewed yet."""
        return not self.searched and iteration >= self.opened + round(SETTLE * self.total)

    def holds(self, iteration: int) -> bool:
        """Motion waits at this step."""
        return iteration < self.hold_until

    def renew(
        self, model: Model, views: Views, frames: list[int], scale: float, iteration: int, log: Callable[[str], None]
    ) -> Tensor | None:
        """Spread the nodes over what is there by now, with twice the keys, and give bodies to parts that turn.

        frames: views in which the error is measured, at ``scale``. Returns the source of each row of ``model.gaussians`` as
        `bodies_for_turning_parts` does; every parameter of ``model.field`` is new.
        """
        self.searched = True
        nodes, gaussians = model.field, model.gaussians
        assert isinstance(nodes, ControlNodes)
        solid = gaussians.means.detach()[gaussians.opacities.detach() > SOLID].cpu().numpy()
        positions = torch.tensor(farthest_points(solid, NODES), device=model.device) if len(solid) else nodes.positions
        model.field = nodes.resampled(positions, 2 * nodes.keys - 1)
        error = measure_responsibility(model, views, frames, True, scale).error_gaussians
        source = bodies_for_turning_parts(model, views, error, self.seed, log)
        if source is not None:
            self.hold_until = iteration + round(HOLD * self.total)
        return source
