"""Light that changes over time: a few courses that the whole scene shares and each primitive follows by its own `shades` [SHADES]."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from ...cuda.over_time import OverTime
from ..times import Time, together
from .courses import TIME_BANDS, encode_times, layers, through

SHADES = 3  # courses of light that the colours of primitives can follow
WIDTH = 64


class Light(nn.Module):
    """A small network from a time to the courses of light.

    Args:
        seed: of the initial weights.
    """

    def __init__(self, seed: int = 0) -> None:
        super().__init__()
        self.courses = nn.ModuleList(layers([1 + 2 * TIME_BANDS, WIDTH, SHADES], torch.Generator().manual_seed(seed)))
        self._at = OverTime(lambda times: (through(self.courses, encode_times(times)),), lambda: self)

    def forward(self, t: Time) -> Tensor:
        """[SHADES] courses of light at ``t``, clamped to [0, 1]."""
        return self._at(together([t]))[0][0]

    def _apply(self, *args: Any, **kwargs: Any) -> Light:
        """Where torch moves a module or changes its type."""
        super()._apply(*args, **kwargs)
        self._at.forget()
        return self
