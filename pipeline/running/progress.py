"""Progress of a long loop: a bar with the time left on a terminal, an occasional line elsewhere, and nothing for short loops."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable
from datetime import timedelta
from typing import TYPE_CHECKING, Any

from .say import say

if TYPE_CHECKING:
    from rich.console import Console

_QUIET_SECONDS = 1.0  # a loop that ends sooner shows nothing
_LINE_SECONDS = 10.0
_LOOKED_BACK = 60.0  # s; the time left follows from the speed in these, as it changes while Gaussians are added
_LABEL = 4  # what is being done takes at most this part of the terminal
_ROOM_FOR_A_BAR = 100  # columns of the terminal from which there is a bar; below, the numbers and the note take its place


class Progress:
    """``with ctx.progress(3000, "training") as bar: bar.advance(note="loss 0.01")``."""

    def __init__(self, total: int, label: str, console: Console | None = None, line_seconds: float = _LINE_SECONDS) -> None:
        self.total, self.label, self.done = max(0, int(total)), label, 0
        self._console, self._line_seconds = console, line_seconds
        self._start = self._last = time.monotonic()
        self._marks: deque[tuple[float, float]] = deque()  # clock, work done until then
        self._parts: list[tuple[int, float]] = []
        self._bar: Any = None
        self._task: Any = None

    def weigh(self, parts: Iterable[tuple[int, float]]) -> None:
        """Tells how long units take, for the time left: (number of units, time of each beside the others), in their order. Without it all
        take the same."""
        self._parts = list(parts)

    def advance(self, n: int = 1, note: str = "") -> None:
        """Counts ``n`` more units as done. ``note`` is shown beside the bar."""
        self.done += n
        now = time.monotonic()
        self._marks.append((now, self._work(self.done)))
        while len(self._marks) > 2 and now - self._marks[1][0] >= _LOOKED_BACK:
            self._marks.popleft()
        if self._console is None or now - self._start < _QUIET_SECONDS:
            return
        if self._console.is_terminal and not self._console.is_dumb_terminal:
            self._show_bar(note)
        elif now - self._last >= self._line_seconds:
            self._last = now
            say(self._line(note), to=self._console)

    def _show_bar(self, note: str) -> None:
        if self._bar is None:
            from rich import progress
            from rich.table import Column

            assert self._console is not None
            whole = [Column(no_wrap=True, min_width=width) for width in (4, 2 * len(str(self.total)) + 1, 7)]  # never cut
            columns: list[progress.ProgressColumn] = [
                progress.TextColumn(
                    "  {task.description}", table_column=Column(no_wrap=True, overflow="ellipsis", max_width=self._console.width // _LABEL)
                ),
                progress.TaskProgressColumn(table_column=whole[0]),
                progress.MofNCompleteColumn(table_column=whole[1]),
                progress.TextColumn("[progress.remaining]{task.fields[left]}", table_column=whole[2]),
            ]
            if self._console.width >= _ROOM_FOR_A_BAR:
                columns.insert(1, progress.BarColumn(bar_width=24))
            columns.append(progress.TextColumn("{task.fields[note]}", table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1)))
            self._bar = progress.Progress(*columns, console=self._console, transient=True, expand=True)
            self._task = self._bar.add_task(self.label, total=self.total, note=note, left="")
            self._bar.start()
        left = f"{timedelta(seconds=round(self._left()))}"
        self._bar.update(self._task, completed=self.done, total=self.total, left=left, **({"note": note} if note else {}))

    def _work(self, units: int) -> float:
        """Time that the first ``units`` take beside others, by `weigh`."""
        work = 0.0
        for count, each in self._parts:
            work += min(max(units, 0), count) * each
            units -= count
        return work + max(units, 0)

    def _left(self) -> float:
        """Seconds. From the first unit that was counted on: what an earlier run has done took no time in this one."""
        (began, before), (now, done) = self._marks[0], self._marks[-1]
        if done <= before:
            began, before = self._start, 0.0
        return (now - began) / max(done - before, 1e-9) * max(0.0, self._work(self.total) - done)

    def _line(self, note: str) -> str:
        percent = 100 * self.done / self.total if self.total else 100.0
        return f"  {self.label}: {self.done}/{self.total} ({percent:.0f} %), {duration(self._left())} left{', ' + note if note else ''}"

    def close(self) -> None:
        """Removes the bar. Called at the end of the ``with`` block."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def counted(count: int, what: str, many: str = "") -> str:
    """``1 camera``, ``2 cameras``. many: the plural of ``what`` if it does not end in s alone."""
    return f"{count} {what if count == 1 else many or what + 's'}"


def duration(seconds: float) -> str:
    """``0.42 s``, ``12 s``, ``3 min 05 s``, ``2 h 10 min``."""
    if seconds < 10:
        return f"{seconds:.2g} s"
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"
