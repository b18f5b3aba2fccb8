"""`Bars`: shows the progress of the worker process as progress bars."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ...pipeline import Context, Progress

LABELS = {
    "matches": "matching",
    "turning": "how the camera turns",
    "mapping": "registering",
    "moving": "moving objects",
    "between": "frames between",
    "verify": "matches off moving pixels",
}


class Bars:
    """One progress bar for each phase of the worker."""

    def __init__(self, ctx: Context) -> None:
        self.ctx, self.phase, self.done = ctx, "", 0
        self.bar: Progress | None = None

    def __call__(self, phase: str, done: int, total: int) -> None:
        if phase != self.phase or done < self.done:
            self.close()
            self.phase, self.done = phase, 0
            self.bar = self.ctx.progress(total, LABELS.get(phase, phase))
            self.bar.__enter__()
        if self.bar is not None:
            self.bar.advance(done - self.done)
        self.done = done

    def close(self) -> None:
        if self.bar is not None:
            self.bar.__exit__(None, None, None)
            self.bar = None
