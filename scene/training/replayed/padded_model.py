"""The model that CUDA graphs read: its primitives, in memory with spare rows."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ...cuda.graph import unchanged
from ...model import Model
from ...primitives import PrimitiveSet
from .padded_set import PaddedSet


class PaddedModel:
    """Keeps the primitives of a model in a `PaddedSet` for each kind.

    ``generation``: how often graphs that were made before had to be made again. ``loads``: how often something else was put into the
    memory. ``pool``: memory that the graphs of one generation share.
    """

    def __init__(self) -> None:
        self.generation = self.loads = 0
        self.pool: Any = None
        self._sets: list[PaddedSet] = []
        self._modules: tuple[Any, ...] = ()  # the model's other parts; held, so that no other ones can take their memory
        self._loaded: tuple[Any, ...] = ()  # what the memory holds; sets are held, too

    def load(self, model: Model) -> None:
        """Let the memory hold ``model``, whose parameters are moved there."""
        sets: tuple[PrimitiveSet, ...] = (model.gaussians, model.convexes)
        links = tuple(None if model.field is None else model.links(s) for s in sets)
        loaded = *sets, *(s.dynamic for s in sets), *(s.dynamic._version for s in sets), *map(_place, links)
        modules = model.field, model.affine
        same_modules = unchanged(modules, self._modules)
        if same_modules and unchanged(loaded, self._loaded):
            return
        indices = tuple(model.moving(s) for s in sets)
        fits = len(self._sets) == len(sets) and all(map(PaddedSet.fits, self._sets, sets, indices, links))
        if not fits:
            self._sets = list(map(PaddedSet, sets, indices, links))
        if not fits or not same_modules:
            self.generation, self._modules = self.generation + 1, modules
            self.pool = torch.cuda.graph_pool_handle() if model.device.type == "cuda" else None
        for memory, primitives, index, link in zip(self._sets, sets, indices, links):
            own = memory.load(primitives, index, link)
            if own is not None:
                model.set_links(primitives, own)
        self.loads += 1
        self._loaded = *loaded[:-2], *(None if model.field is None else _place(model.links(s)) for s in sets)

    def padded(self, model: Model) -> Model:
        """``model`` with all rows of the memory, which a graph may read."""
        return model.in_rooms([(memory.padded, memory.index, memory.link) for memory in self._sets])


def _place(link: Tensor | None) -> int | None:
    return None if link is None else link.data_ptr()
