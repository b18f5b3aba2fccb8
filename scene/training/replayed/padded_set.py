"""Primitives in memory with spare rows, in which a CUDA graph computes while their number changes."""

from __future__ import annotations

from typing import Generic, TypeVar

import torch
from torch import Tensor

from ...primitives import PrimitiveSet

Set = TypeVar("Set", bound=PrimitiveSet)
SPARE, LEAST_SPARE = 1.25, 256  # factor on the number of rows, and rows in addition
SHRINKS = 2.0  # memory for more than so many times the rows is given up
TRANSPARENT = -100.0  # logit of the opacity of spare rows: exactly 0


class PaddedSet(Generic[Set]):
    """Memory for more primitives than ``primitives`` has; its spare rows are transparent ones. An empty set has none.

    ``primitives``: `load` moves its parameters here, so that optimiser and graph work in the same memory. ``index`` [m] int64: those that
    move. ``link``: see `Motion.links`. ``padded``: the set of all rows, with leaves of its own, which a graph may read.
    """

    def __init__(self, primitives: Set, index: Tensor, link: Tensor | None) -> None:
        n = len(primitives)
        rows = round(SPARE * n) + LEAST_SPARE if n else 0
        parameters = {name: p.detach().new_zeros(rows, *p.shape[1:]) for name, p in primitives.parameters.items()}
        self.padded = type(primitives)(parameters, torch.zeros(rows, dtype=torch.bool, device=primitives.device))
        self.whole = len(index) == n
        moving = rows if self.whole else min(round(SPARE * len(index)) + LEAST_SPARE, rows) if len(index) else 0
        self.index = torch.arange(moving, device=primitives.device)
        self.corners = len(primitives.rest_points()) // max(n, 1)
        self.link = None if link is None else link.new_zeros(self.corners * rows, *link.shape[1:])

    def fits(self, primitives: PrimitiveSet, index: Tensor, link: Tensor | None) -> bool:
        """Whether `load` may be called with these: a graph that reads this memory stays right."""
        n, rows = len(primitives), len(self.padded)
        if (n == 0) != (rows == 0) or (link is None) != (self.link is None):
            return False
        if any(p.shape[1:] != primitives.parameters[name].shape[1:] for name, p in self.padded.parameters.items()):
            return False
        # Rows that stay transparent stand for those that move where there are fewer than before, so there must be one.
        enough = n < rows <= SHRINKS * (n + LEAST_SPARE) or rows == 0
        moving = self.whole if len(index) == n else not self.whole and 0 < len(index) <= len(self.index)
        return enough and (moving or len(index) == len(self.index) == 0)

    @torch.no_grad()
    def load(self, primitives: Set, index: Tensor, link: Tensor | None) -> Tensor | None:
        """Copy ``primitives`` in, and let their parameters be rows of this memory. Returns its part of ``link``."""
        n = len(primitives)
        for name, p in primitives.parameters.items():
            there = self.padded.parameters[name].detach()
            there[:n] = p.detach()
            there[n:] = TRANSPARENT if name == "opacity_logits" else 0.0
            p.data = there[:n]
        if "quats" in self.padded.parameters:
            self.padded.parameters["quats"].detach()[n:, 0] = 1.0
        self.padded.dynamic[:n] = primitives.dynamic
        self.padded.dynamic[n:] = self.whole
        if not self.whole:
            self.index[: len(index)] = index
            # Not one row for all: gradients of the same row are added up one after another.
            self.index[len(index) :] = n + torch.arange(len(self.index) - len(index), device=index.device) % (len(self.padded) - n)
        if self.link is None or link is None:
            return None
        own = self.link[: self.corners * n]
        own.copy_(link)
        return own
