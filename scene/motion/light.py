"""Light that changes over time: a few courses that the whole scene shares and each primitive follows by its own `shades`."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ..primitives import SHADES
from .courses import TIME_BANDS, encode_times, layers, through

WIDTH = 64


class Light(nn.Module):
    """A small network from a time to the courses of light.

    Args:
        seed: of the initial weights.
    """

    def __init__(self, seed: int = 0) -> None:
        super().__init__()
        self.courses = nn.ModuleList(layers([1 + 2 * TIME_BANDS, WIDTH, SHADES], torch.Generator().manual_seed(seed)))

    def forward(self, t: float) -> Tensor:
        """[SHADES] courses of light at ``t``, clamped to [0, 1]."""
        return through(self.courses, encode_times([t], next(self.parameters())))[0]
