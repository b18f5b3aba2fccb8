"""Where control nodes lie: spread evenly over the scene."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from .skinning import distances


def spacing(positions: Tensor) -> Tensor:
    """[B] mean distance of each of ``positions`` [B, 3] to its three nearest neighbours; 1 for a single position."""
    near = min(3, len(positions) - 1)
    if not near:
        return torch.ones(len(positions), device=positions.device)
    return distances(positions, positions).topk(near + 1, largest=False).values[:, 1:].mean(1).clamp(min=1e-6)


def farthest_points(points: np.ndarray, count: int) -> np.ndarray:
    """Up to ``count`` of ``points`` [P, 3] by farthest point sampling: each is as far as possible from those before it. The first is the
    one nearest to the mean."""
    first = int(np.linalg.norm(points - points.mean(0), axis=1).argmin())
    chosen = [first]
    distance = np.linalg.norm(points - points[first], axis=1)
    while len(chosen) < min(count, len(points)) and distance.max() > 0:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return points[chosen]
