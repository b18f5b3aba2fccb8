"""A CUDA graph of a function that returns tensors."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol

import torch
from torch import Tensor

from ...rasterizer.cuda.capacity import Watched, watching

Results = list[Tensor | None]


class Recorded(Protocol):
    """``results`` of a function, which `replay` computes in the same memory. frames: those that it draws."""

    results: Results
    frames: list[Watched]

    def replay(self) -> None: ...


def unchanged(now: Sequence[object], before: Sequence[object]) -> bool:
    """Whether what a graph reads is still there: the same objects, and equal numbers, such as addresses."""
    return len(now) == len(before) and all(a is b or (isinstance(a, int) and a == b) for a, b in zip(now, before))


def in_capture(device: torch.device) -> bool:
    """Whether what is computed on ``device`` now becomes part of a CUDA graph."""
    return device.type == "cuda" and torch.cuda.is_current_stream_capturing()


@contextmanager
def capturing(graph: torch.cuda.CUDAGraph, pool: Any = None) -> Iterator[None]:
    """What is queued inside becomes ``graph``. What other threads do, such as a viewer that renders, does not end the capture; a graph that
    the garbage collector deletes in this thread would, so it waits."""
    collects = gc.isenabled()
    gc.disable()
    try:
        with torch.cuda.graph(graph, pool=pool, capture_error_mode="thread_local"):
            yield
    finally:
        if collects:
            gc.enable()


class Graph:
    """``function`` as a CUDA graph. It must not wait for the device. Graphs of the same ``pool`` share memory, except for their results:
    they must not run at the same time."""

    def __init__(self, function: Callable[[], Results], device: torch.device, pool: Any) -> None:
        self._graph = torch.cuda.CUDAGraph()
        with watching(device) as frames, capturing(self._graph, pool):
            self.results = function()
        self.frames = list(frames)

    def replay(self) -> None:
        self._graph.replay()
