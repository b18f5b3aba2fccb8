"""SIGTERM ends a command as Ctrl-C does, and neither of them is lost."""

from __future__ import annotations

import os
import signal
import sys
import threading
from types import FrameType

AGAIN = 0.05  # s after which an interrupt that was lost comes again


def end_cleanly_when_terminated() -> None:
    """A cluster's SIGTERM raises KeyboardInterrupt: temporary folders are removed, checkpoints stay.

    Python drops an exception that is raised in a callback of a weak reference or in ``__del__``, an interrupt too: a run that was asked to
    end would go on. Such an interrupt is raised again, once the callback is over. Outside the main thread nothing is changed: there the
    caller handles signals.
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
