"""Measures where the time of nested calls and of a backward pass goes, as exclusive seconds per part."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from torch.autograd.graph import Node
from torch.utils.hooks import RemovableHandle


class Clock:
    """Sums seconds by the name of a part. The time of a nested part is not counted for the outer one, unless the outer one is named in
    ``whole``: then everything it calls counts as its own."""

    def __init__(self, whole: tuple[str, ...] = ()) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._whole = whole
        self._open: list[str] = []
        self._since = 0.0

    def enter(self, part: str) -> None:
        now = time.perf_counter()
        if self._open:
            self.seconds[self._open[-1]] += now - self._since
        self._open.append(self._open[-1] if self._inside_whole() else part)
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

    def wrapped(self, function: Callable[..., Any], part: str, after: Callable[[Any], None] | None = None) -> Callable[..., Any]:
        """``function`` with its time counted as ``part``. ``after`` is called with each result, except inside a part named in ``whole``."""

        def timed(*args: Any, **options: Any) -> Any:
            with self.part(part):
                result = function(*args, **options)
            if after is not None and not self._inside_whole():
                after(result)
            return result

        return timed

    def watch(self, nodes: set[Node], part: str) -> list[RemovableHandle]:
        """Counts the backward pass through these nodes of the graph as ``part``. The returned handles remove the hooks."""
        before, after = (lambda grads: self.enter(part)), (lambda inputs, outputs: self.leave())
        return [handle for node in nodes for handle in (node.register_prehook(before), node.register_hook(after))]

    def _inside_whole(self) -> bool:
        return bool(self._open) and self._open[-1] in self._whole
