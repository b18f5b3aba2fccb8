"""Where the time of nested calls and of a backward pass goes: exclusive seconds by part."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from torch import Tensor
from torch.autograd.graph import Node
from torch.utils.hooks import RemovableHandle


class Clock:
    """Sums seconds by the name of a part. A part that is entered within another one takes its time away from it."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._open: list[str] = []
        self._since = 0.0

    def enter(self, part: str) -> None:
        now = time.perf_counter()
        if self._open:
            self.seconds[self._open[-1]] += now - self._since
        self._open.append(part)
        self._since = now

    def leave(self) -> None:
        now = time.perf_counter()
        self.seconds[self._open.pop()] += now - self._since
        self._since = now

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        self.enter(name)
        try:
            yield
        finally:
            self.leave()

    def wrapped(self, function: Callable[..., Any], part: str, after: Callable[[Any], None] = lambda result: None) -> Callable[..., Any]:
        """``function`` with its time counted as ``part``; ``after`` is called with each result."""

        def timed(*args: Any, **options: Any) -> Any:
            with self.part(part):
                result = function(*args, **options)
            after(result)
            return result

        return timed

    def watch(self, nodes: set[Node], part: str) -> list[RemovableHandle]:
        """Count the backward pass through these nodes of the graph as ``part``; the handles take the hooks away."""
        handles: list[RemovableHandle] = []
        for node in nodes:
            handles.append(node.register_prehook(lambda grads: self.enter(part)))
            handles.append(node.register_hook(lambda inputs, outputs: self.leave()))
        return handles


def nodes_behind(tensors: list[Tensor], stop: set[Node] | None = None) -> set[Node]:
    """Nodes of the autograd graph from which ``tensors`` were computed; the walk goes no further than ``stop``, which is left out."""
    found: set[Node] = set()
    waiting = [t.grad_fn for t in tensors if t.grad_fn is not None]
    while waiting:
        node = waiting.pop()
        if node in found or (stop and node in stop):
            continue
        found.add(node)
        waiting += [following for following, _ in node.next_functions if following is not None]
    return found
