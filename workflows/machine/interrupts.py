"""Makes SIGTERM end a command as Ctrl-C does, and makes sure that neither is lost."""

from __future__ import annotations

import os
import signal
import sys
import threading
from types import FrameType

AGAIN = 0.05  # s after which a lost interrupt is raised again


def end_cleanly_when_terminated() -> None:
    """Makes a cluster's SIGTERM raise KeyboardInterrupt, so that temporary folders are removed and checkpoints stay.

    Python drops exceptions raised in a callback of a weak reference or in ``__del__``, including interrupts, so a run that was asked to end
    would go on. Such an interrupt is raised again after the callback. Outside the main thread nothing changes, since the caller handles
    signals there.
    """
    try:
        signal.signal(signal.SIGTERM, _interrupt)
    except ValueError:
        return
    if not isinstance(sys.unraisablehook, _Hook):
        sys.unraisablehook = _Hook()


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


class _Hook:
    def __init__(self) -> None:
        self.before = sys.unraisablehook

    def __call__(self, dropped: sys.UnraisableHookArgs) -> None:
        if issubclass(dropped.exc_type, KeyboardInterrupt):
            again = threading.Timer(AGAIN, os.kill, (os.getpid(), signal.SIGTERM))
            again.daemon = True
            again.start()
        else:
            self.before(dropped)
