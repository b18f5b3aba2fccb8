"""Space for a frame's visible primitives and pairs, before their numbers are known."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from .state import Inputs

SPARE, SPARE_PAIRS = 1.1, 1.25  # factors on the primitives and pairs that the last frames of this size took
GRAPH_SPARE = 1.5  # the same inside a CUDA graph, where what is beyond the space is lost
LIKELY_ROOM, GRAPH_ROOM = 1024, 1024  # and in addition
FORGET = 0.98  # of what was taken is remembered after a frame that took less


class Room(NamedTuple):
    """How many Gaussians, convexes, and pairs of a tile and a primitive there is space for, or are needed."""

    gaussians: int
    convexes: int
    pairs: int


Key = tuple[torch.device, int, int]
_TAKEN: dict[Key, tuple[float, float, float]] = {}  # what the last frames of a size took: Gaussians, convexes and pairs


def room_in_graph(inputs: Inputs) -> Room | None:
    """None outside of a capture. Inside one, where buffers are fixed and waiting for the device is not allowed, the space to allocate:
    `GRAPH_SPARE` times what the last frames on this device and of this size took, plus `GRAPH_ROOM`.

    Raises RuntimeError inside a capture if there was no such frame.
    """
    if inputs.device.type != "cuda" or not torch.cuda.is_current_stream_capturing():
        return None
    taken = _TAKEN.get(_key(inputs))
    if taken is None:
        raise RuntimeError(
            f"a CUDA graph is being captured, and no frame of {inputs.width} x {inputs.height} was rendered on {inputs.device} "
            "before: render one first, from which the graph's buffers take their size"
        )
    return _room(inputs, taken, (GRAPH_SPARE, GRAPH_SPARE), GRAPH_ROOM)


def likely_room(inputs: Inputs) -> Room | None:
    """The space that will probably do for the next frame on this device and of this size; None if there was none yet."""
    taken = _TAKEN.get(_key(inputs))
    return None if taken is None else _room(inputs, taken, (SPARE, SPARE_PAIRS), LIKELY_ROOM)


def took(inputs: Inputs, used: Room) -> None:
    """Remember what a frame took."""
    _remember(_key(inputs), used, FORGET)


def _key(inputs: Inputs) -> Key:
    return inputs.device, inputs.width, inputs.height


def _room(inputs: Inputs, taken: tuple[float, float, float], spare: tuple[float, float], more: int) -> Room:
    gaussians, convexes = (int(spare[0] * number) + more for number in taken[:2])
    return Room(min(gaussians, inputs.n), min(convexes, inputs.m), int(spare[1] * taken[2]) + more)


def _remember(key: Key, used: Iterable[float], forget: float = 1.0) -> None:
    gaussians, convexes, pairs = (max(now, forget * before) for now, before in zip(used, _TAKEN.get(key, (0.0, 0.0, 0.0))))
    _TAKEN[key] = gaussians, convexes, pairs


@dataclass(frozen=True, eq=False)
class Watched:
    """A frame in a CUDA graph, which has ``room``. most [3] int64: the most Gaussians, convexes and pairs that a replay has had."""

    key: Key
    room: Room
    most: Tensor

    def overflowed(self) -> bool:
        """Whether a replay has left primitives or pairs out; then the next graph gets more room. Waits for the device."""
        most = self.most.tolist()
        if all(number <= there for number, there in zip(most, self.room)):
            return False
        _remember(self.key, most)
        return True


_WATCHED: list[tuple[list[Watched], Tensor]] = []  # of every `watching` that is entered: the frames, and where their `most` is
MOST_FRAMES = 16  # of one graph


@contextmanager
def watching(device: torch.device) -> Iterator[list[Watched]]:
    """Inside, collects the frames that are captured on ``device``. Enter it before the capture begins, so that replays do not start
    again at 0."""
    frames: list[Watched] = []
    _WATCHED.append((frames, torch.zeros(MOST_FRAMES, len(Room._fields), dtype=torch.int64, device=device)))
    try:
        yield frames
    finally:
        _WATCHED.pop()


def captured(inputs: Inputs, room: Room, counts: Tensor) -> None:
    """Tell who is `watching` of a frame in a capture, whose numbers of Gaussians, convexes and pairs are the first of ``counts``."""
    for frames, most_of_each in _WATCHED:
        if len(frames) < MOST_FRAMES:
            most = most_of_each[len(frames)]
            torch.maximum(most, counts[: len(room)], out=most)
            frames.append(Watched(_key(inputs), room, most))
