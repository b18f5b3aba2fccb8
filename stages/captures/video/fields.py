"""Interlaced video: whether frames that are flagged as such really hold two times, and their deinterlacing by FFmpeg's bwdif."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from fractions import Fraction
from typing import Any

import numpy as np

MOST_LOOKED_AT = 60  # frames; with less motion than that deinterlacing changes nothing either
_ENOUGH = 8  # pairs of frames with motion
_LEAST_MOVING = 40  # px of a pair of frames
_MOVES = 12  # levels by which a pixel changes that moves
_APART = 1.08  # ratio of the two distances from which fields are of two times


class FieldTest:
    """Tells frames whose fields are of two times from whole frames that are flagged as interlaced.

    In the first kind one field of a frame is three field times away from the other field of the frame before, and the other field one;
    in whole frames both are two away. So where something moves, lines woven from two frames fit one way much better than the other. Only
    moving pixels count, because cameras of a rig stand still (FFmpeg's idet takes whole pictures, and cannot tell then).
    """

    def __init__(self) -> None:
        self._before: np.ndarray | None = None
        self._misfit = np.zeros(2)
        self._seen = self._moving = 0

    def add(self, frame: Any) -> None:
        picture = frame.to_ndarray(format="gray").astype(np.float32)
        before, self._before = self._before, picture
        self._seen += 1
        if before is None or before.shape != picture.shape or len(picture) < 8:
            return
        moves = np.abs(picture - before) > _MOVES
        moves = moves[:-2] | moves[1:-1] | moves[2:]
        if moves.sum() < _LEAST_MOVING:
            return
        misfit = np.abs(before[:-2] + before[2:] - 2 * picture[1:-1]) * moves
        self._misfit += misfit[::2].sum(), misfit[1::2].sum()
        self._moving += 1

    @property
    def is_over(self) -> bool:
        return self._moving >= _ENOUGH or self._seen >= MOST_LOOKED_AT

    @property
    def parity(self) -> str | None:
        """ "tff" or "bff": the field that comes first as the pictures show it, whatever the file says. None for whole frames. "auto", as
        the file says, if nothing moves."""
        if not self._moving:
            return "auto"
        upper, lower = self._misfit  # of the earlier frame's upper lines with the lower lines, and the reverse
        if max(upper, lower) <= _APART * min(upper, lower):
            return None
        return "tff" if upper > lower else "bff"


class Filter:
    """One of FFmpeg's filters, which gives one frame for each that it gets, in order, some of them later."""

    def __init__(self, frame: Any, name: str, arguments: str | None = None) -> None:
        from av.filter import Graph

        self.kind = (frame.width, frame.height, frame.format.name)
        self._graph = Graph()
        source = self._graph.add_buffer(
            width=frame.width, height=frame.height, format=frame.format, time_base=frame.time_base or Fraction(1, 1000)
        )
        work = self._graph.add(name, arguments)
        source.link_to(work)
        work.link_to(self._graph.add("buffersink"))
        self._graph.configure()

    def push(self, frame: Any) -> Iterator[Any]:
        """frame: None at the end."""
        from av import EOFError
        from av.error import BlockingIOError

        self._graph.push(frame)
        while True:
            try:
                yield self._graph.pull()
            except (BlockingIOError, EOFError):
                return


def deinterlaced(frames: Iterable[tuple[int | None, Any]], parity: str) -> Iterator[tuple[int | None, Any]]:
    """(number, frame) pairs with the interlaced frames made whole, at their first field's time; the others stay as they are. A few frames
    are in memory at a time."""
    work: Filter | None = None
    waiting: deque[int | None] = deque()
    for number, frame in frames:
        if work is not None and work.kind != (frame.width, frame.height, frame.format.name):
            yield from ((waiting.popleft(), done) for done in work.push(None))
            work = None
        if work is None:
            work = Filter(frame, "bwdif", f"mode=send_frame:parity={parity}:deint=interlaced")
        waiting.append(number)
        yield from ((waiting.popleft(), done) for done in work.push(frame))
    if work is not None:
        yield from ((waiting.popleft(), done) for done in work.push(None))
