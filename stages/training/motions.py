"""The initial motion models of `coarse`, placed over the extent of the scene."""

from __future__ import annotations

import numpy as np
import torch

from ...scene.motion.nodes.control_nodes import ControlNodes, farthest_points
from ...scene.motion.planes.field import DeformationField
from ...scene.settings import TrainingSettings
from ...scene.views import Views

NODES = 512


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
