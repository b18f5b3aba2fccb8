"""Space for a frame's pairs, before their number is known."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor

from .state import Inputs

SPARE = 1.25  # factor on what the last frames of this size took
GRAPH_SPARE, GRAPH_ROOM = 1.5, 1024  # the same inside a CUDA graph, where pairs beyond the space are lost; and pairs in addition
FORGET = 0.98  # of that number is left after a frame that took less

_TAKEN: dict[tuple[torch.device, int, int], float] = {}  # what the last frames of a size took


def room_in_graph(inputs: Inputs) -> int | None:
    """None outside of a capture. Inside one, where buffers are fixed and waiting for the device is not allowed, the number of pairs to
    allocate: `GRAPH_SPARE` times what the last frames on this device and of this size took, plus `GRAPH_ROOM`.

    Raises RuntimeError inside a capture if there was no such frame.
    """
    if inputs.device.type != "cuda" or not torch.cuda.is_current_stream_capturing():
        return None
    taken = _TAKEN.get((inputs.device, inputs.width, inputs.height))
    if taken is None:
        raise RuntimeError(
            f"a CUDA graph is being captured, and no frame of {inputs.width} x {inputs.height} was rendered on {inputs.device} "
            "before: render one first, from which the graph's buffers take their size"
        )
    return int(GRAPH_SPARE * taken) + GRAPH_ROOM


def likely_room(inputs: Inputs) -> int | None:
    """The number of pairs that will probably do for the next frame on this device and of this size; None if there was none yet."""
    taken = _TAKEN.get((inputs.device, inputs.width, inputs.height))
    return None if taken is None else int(SPARE * taken) + 1024


def took(inputs: Inputs, pairs: int) -> None:
    """Remember a frame's number of pairs."""
    key = inputs.device, inputs.width, inputs.height
    _TAKEN[key] = max(pairs, FORGET * _TAKEN.get(key, 0.0))


@dataclass(frozen=True, eq=False)
class Watched:
    """A frame in a CUDA graph, which has ``room`` for pairs. most [1]: the most that a replay has had."""

    key: tuple[torch.device, int, int]
    room: int
    most: Tensor

    def overflowed(self) -> bool:
        """Whether a replay has left pairs out; then the next graph gets more room. Waits for the device."""
        pairs = int(self.most)
        if pairs <= self.room:
            return False
        _TAKEN[self.key] = max(pairs, _TAKEN.get(self.key, 0.0))
        return True


_WATCHED: list[tuple[list[Watched], Tensor]] = []  # of every `watching` that is entered: the frames, and where their `most` is
MOST_FRAMES = 16  # of one graph


@contextmanager
def watching(device: torch.device) -> Iterator[list[Watched]]:
    """Inside, collects the frames that are captured on ``device``. Enter it before the capture begins, so that replays do not start
    again at 0."""
    frames: list[Watched] = []
    _WATCHED.append((frames, torch.zeros(MOST_FRAMES, dtype=torch.int64, device=device)))
    try:
        yield frames
    finally:
        _WATCHED.pop()


def captured(inputs: Inputs, room: int, ends: Tensor) -> None:
    """Tell who is `watching` of a frame in a capture, whose running sums of pairs are ``ends``."""
    for frames, counts in _WATCHED:
        if len(ends) and len(frames) < MOST_FRAMES:
            most = counts[len(frames) : len(frames) + 1]
            torch.maximum(most, ends[-1:], out=most)
            frames.append(Watched((inputs.device, inputs.width, inputs.height), room, most))
