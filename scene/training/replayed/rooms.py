"""The model that CUDA graphs read: its primitives, in memory with room for more."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ...cuda.graph import unchanged
from ...model import Model
from ...primitives import PrimitiveSet
from .room import Room


class Rooms:
    """Keeps the primitives of a model in a `Room` for each kind. ``age``: how often graphs that were made before had to be made again.
    ``pool``: memory that the graphs of one age share."""

    def __init__(self) -> None:
        self.age = 0
        self.pool: Any = None
        self._rooms: list[Room] = []
        self._modules: tuple[Any, ...] = ()  # the model's other parts; held, so that no other ones can take their memory
        self._taken: tuple[Any, ...] = ()  # what the rooms hold; sets are held, too
        self.changes = 0  # how often something else was put into the rooms

    def hold(self, model: Model) -> None:
        """Let the rooms hold ``model``, whose parameters are moved there."""
        sets: tuple[PrimitiveSet, ...] = (model.gaussians, model.convexes)
        links = tuple(model.links(s) for s in sets)
        taken = *sets, *(s.dynamic for s in sets), *(s.dynamic._version for s in sets), *map(_place, links)
        modules = model.motion, model.affine
        same_modules = unchanged(modules, self._modules)
        if same_modules and unchanged(taken, self._taken):
            return
        indices = tuple(model.moving(s) for s in sets)
        fits = len(self._rooms) == len(sets) and all(map(Room.fits, self._rooms, sets, indices, links))
        if not fits:
            self._rooms = list(map(Room, sets, indices, links))
        if not fits or not same_modules:
            self.age, self._modules = self.age + 1, modules
            self.pool = torch.cuda.graph_pool_handle() if model.device.type == "cuda" else None
        for room, primitives, index, link in zip(self._rooms, sets, indices, links):
            own = room.take(primitives, index, link)
            if own is not None:
                model.set_links(primitives, own)
        self.changes += 1
        self._taken = *taken[:-2], *(_place(model.links(s)) for s in sets)

    def whole(self, model: Model) -> Model:
        """``model`` with all rows of the rooms, which a graph may read."""
        return model.in_rooms([(room.held, room.index, room.link) for room in self._rooms])


def _place(link: Tensor | None) -> int | None:
    return None if link is None else link.data_ptr()
