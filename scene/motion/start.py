"""What a motion starts from: the seeds of the Gaussians, and which of them may move."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
import torch

from ..primitives import GaussianSet


class MovingSeeds(Protocol):
    """Seeds on moving objects at several times. points [P, 3] world units, colors [P, 3] in [0, 1], velocities [P, 3] world units a frame,
    time [P] in [0, 1] of each position."""

    @property
    def points(self) -> np.ndarray: ...
    @property
    def colors(self) -> np.ndarray: ...
    @property
    def velocities(self) -> np.ndarray: ...
    @property
    def time(self) -> np.ndarray: ...


class Start(NamedTuple):
    """Seeds of the Gaussians. points [N, 3] world units; colors [N, 3] in [0, 1]; dynamic [N] bool. moving: further seeds on moving
    objects, at several times. sh_degree: of the Gaussians. max_scale: their largest initial standard deviation, world units."""

    points: np.ndarray
    colors: np.ndarray
    dynamic: np.ndarray
    moving: MovingSeeds | None
    sh_degree: int
    max_scale: float

    def at_the_middle(self) -> Start:
        """The same with the moving seeds of the middle time among the others: the rest state is the scene at that time."""
        seeds = self.moving
        if seeds is None:
            return self
        middle = seeds.time == seeds.time[np.abs(seeds.time - 0.5).argmin()]
        points, colors = np.concatenate([self.points, seeds.points[middle]]), np.concatenate([self.colors, seeds.colors[middle]])
        dynamic = np.concatenate([self.dynamic, np.ones(int(middle.sum()), bool)])
        return self._replace(points=points, colors=colors, dynamic=dynamic, moving=None)

    def gaussians(self) -> GaussianSet:
        """Isotropic Gaussians on `points`, of which the `dynamic` ones move."""
        made = GaussianSet.from_points(self.points, self.colors, self.sh_degree, max_scale=self.max_scale)
        made.dynamic = torch.from_numpy(self.dynamic)
        return made
