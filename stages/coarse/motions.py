"""The initial motion models of `coarse`, placed over the extent of the scene, and the Gaussians that live for a part of it."""

from __future__ import annotations

import numpy as np
import torch

from ...scene.motion.field import DeformationField
from ...scene.motion.free import FreeMotion
from ...scene.motion.nodes import ControlNodes, farthest_points
from ...scene.primitives import GaussianSet
from ...scene.seeds.moving.moving_seeds import MovingSeeds
from ...scene.settings import TrainingSettings
from ...scene.views import Views

NODES = 512
OVERLAP = 0.6  # standard deviation of a Gaussian's lifetime, relative to the frames between two times with seeds


def make_nodes(points: np.ndarray, settings: TrainingSettings) -> ControlNodes:
    """Control nodes spread over ``points`` [P, 3]."""
    low, high = np.percentile(points, 1, axis=0), np.percentile(points, 99, axis=0)
    inside = points[((points >= low) & (points <= high)).all(1)]
    extent = max(0.5 * float((high - low).max()), 1e-6)
    positions = farthest_points(inside if len(inside) else points, NODES)
    return ControlNodes(torch.tensor(positions), torch.tensor(0.5 * (low + high)), extent, extent, seed=settings.seed)


def make_field(points: np.ndarray, views: Views, settings: TrainingSettings) -> DeformationField:
    """A field over the bounding box of ``points``, widened by a fifth. The box spans the 1st to the 99th percentile, so outliers do not
    stretch it."""
    low, high = np.percentile(points, 1, axis=0), np.percentile(points, 99, axis=0)
    margin = 0.2 * (high - low).max()
    times = len(np.unique(views.time))
    return DeformationField(torch.tensor(low - margin), torch.tensor(high + margin), times, seed=settings.seed)


def living(seeds: MovingSeeds, motion: FreeMotion, sh_degree: int, max_scale: float) -> list[GaussianSet]:
    """Gaussians on ``seeds``, one set per time, whose lifetimes overlap with those of the times before and after."""
    times = np.unique(seeds.time)
    apart = (motion.times - 1) * float(times[-1] - times[0]) / max(len(times) - 1, 1)
    sets = []
    for t in times:
        row = seeds.time == t
        one = GaussianSet.from_points(seeds.points[row], seeds.colors[row], sh_degree, max_scale=max_scale)
        one.live(motion.frame(t), max(OVERLAP * apart, 1.0), torch.from_numpy(seeds.velocities[row]).float())
        sets.append(one)
    return sets
