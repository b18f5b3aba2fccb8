"""Interlaced video: whether frames that are flagged as such really hold two times, and their deinterlacing by FFmpeg's bwdif."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from fractions import Fraction
from typing import Any

_ENOUGH = 8  # frames that idet must decide on
MOST_LOOKED_AT = 60  # frames; with less motion than that deinterlacing changes nothing either


class FieldTest:
    """Counts frames whose fields are of two times, as FFmpeg's idet sees it."""

    def __init__(self) -> None:
        self._filter: Filter | None = None
        self._seen = self._combed = self._whole = 0

    def add(self, frame: Any) -> None:
        if self._filter is None:
            self._filter = Filter(frame, "idet")
        for done in self._filter.push(frame):
            kind = done.metadata.get("lavfi.idet.single.current_frame")
            self._combed += kind in ("tff", "bff")
            self._whole += kind == "progressive"
            self._seen += 1

    @property
    def is_over(self) -> bool:
        return self._combed + self._whole >= _ENOUGH or self._seen >= MOST_LOOKED_AT

    @property
    def is_interlaced(self) -> bool:
        """False if most frames that show motion are whole. Without motion the flag of the file is believed."""
        return self._combed >= self._whole


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


def deinterlaced(frames: Iterable[tuple[int | None, Any]]) -> Iterator[tuple[int | None, Any]]:
    """(number, frame) pairs with the interlaced frames made whole, at their first field's time; the others stay as they are. A few frames
    are in memory at a time."""
    work: Filter | None = None
    waiting: deque[int | None] = deque()
    for number, frame in frames:
        if work is not None and work.kind != (frame.width, frame.height, frame.format.name):
            yield from ((waiting.popleft(), done) for done in work.push(None))
            work = None
        if work is None:
            work = Filter(frame, "bwdif", "mode=send_frame:parity=auto:deint=interlaced")
        waiting.append(number)
        yield from ((waiting.popleft(), done) for done in work.push(frame))
    if work is not None:
        yield from ((waiting.popleft(), done) for done in work.push(None))
