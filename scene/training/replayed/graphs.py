"""Computations on inputs of a few kinds, each kind captured once as a CUDA graph."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ....rasterizer.uniform import FAR_CAMERA
from ...cuda.graph import Graph, Recorded, Results
from ...model import Model
from ...views import Views
from .buffers import Buffers, structure
from .padded_model import PaddedModel

CHECK_EVERY = 64  # replays between two looks at whether a graph had room for all pairs

Record = Callable[[Callable[[], Results], torch.device, Any], Recorded]
Compute = Callable[[Any], Results]  # of inputs


@dataclass(eq=False)
class Captured:
    """A captured kind of inputs. derived: what its user has made of the results; None after the model's rows have changed."""

    graph: Recorded
    buffers: Buffers
    finds: int = 0
    derived: Any = None

    def overflowed(self) -> bool:
        """Whether a replay had no room for all pairs, and left some out. Waits for the device."""
        return any(frame.overflowed() for frame in self.graph.frames)


class Graphs:
    """Graphs by the structure of their inputs. The first inputs of a kind are computed as usual, the second ones captured.

    A graph computes in memory with room for more primitives than there are, to which the model's parameters are moved, so that it can go on
    when density control adds some and removes others. Computed as usual is all with a six-plane field, which needs the time on the CPU,
    and with cameras so far from the origin that scenes are moved there before they are drawn.

    memory: holds the model. what: is captured, for messages. record: makes graphs. captures: how many were made.
    """

    def __init__(self, views: Views, memory: PaddedModel, what: str, say: Callable[[str], None], record: Record = Graph) -> None:
        self.memory, self._what, self._say, self._record = memory, what, say, record
        self._usable = bool(np.linalg.norm(views.centres(), axis=1).max() < FAR_CAMERA)
        self._known: dict[Hashable, Captured] = {}
        self._seen: set[Hashable] = set()  # kinds that have been computed, so that their kernels are compiled
        self._generation = self._loads = self.captures = 0

    def __len__(self) -> int:
        return len(self._known)

    def find(self, model: Model, inputs: Any, prepare: Callable[[Model], Compute]) -> Captured | None:
        """The graph for ``inputs``, filled with them; None if they are to be computed as usual. prepare: returns what is captured, for the
        model with spare rows."""
        if not self._usable or not model.motion.replayable:
            return None
        kind = structure(inputs)
        if kind not in self._seen:
            self._seen.add(kind)
            return None
        self.memory.load(model)
        if self.memory.generation != self._generation:
            self._generation = self.memory.generation
            self._known.clear()
        if self.memory.loads != self._loads:
            self._loads = self.memory.loads
            for other in self._known.values():
                other.derived = None
        known = self._known.get(kind)
        if known is None:
            try:
                buffers, compute = Buffers(inputs, model.device), prepare(self.memory.padded(model))
                known = Captured(self._record(lambda: compute(buffers.inputs()), model.device, self.memory.pool), buffers)
            except RuntimeError as cause:
                self._usable = False
                self._say(f"{self._what} are not replayed as CUDA graphs: {str(cause).splitlines()[0]}")
                return None
            self._known[kind], self.captures = known, self.captures + 1
        else:
            known.buffers.fill(inputs)
        known.finds += 1
        if known.finds % CHECK_EVERY == 0 and known.overflowed():
            self.forget(known)
            return None
        return known

    def forget(self, captured: Captured) -> None:
        """Pairs were left out; the next graph of its kind has more room."""
        self._known = {kind: other for kind, other in self._known.items() if other is not captured}
