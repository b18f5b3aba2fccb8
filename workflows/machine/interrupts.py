"""Makes SIGTERM end a command as Ctrl-C does, and makes sure that neither is lost."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Sequence
from types import FrameType

AGAIN = 0.05  # s after which an interrupt that Python dropped is raised again
OF_STAGES = ("run", "batch", "bench", "ablation")  # commands whose results are kept stage by stage
WRITING = ("render", "export")  # commands whose files are there when they are complete
PATIENCE = 10.0  # s after which a SIGTERM is raised again if the command has not ended: libraries can lose it, too

_waiting: list[threading.Timer] = []


def end_cleanly_when_terminated() -> None:
    """Makes a cluster's SIGTERM raise KeyboardInterrupt, so that temporary folders are removed and checkpoints stay.

    Python drops exceptions raised in a callback of a weak reference or in ``__del__``, including interrupts, so a run that was asked to end
    would go on. Such an interrupt is raised again after the callback. Outside the main thread nothing changes, since the caller handles
    signals there. `ended` says that the command has ended.
    """
    try:
        signal.signal(signal.SIGTERM, _interrupt)
    except ValueError:
        return
    if not isinstance(sys.unraisablehook, _Hook):
        sys.unraisablehook = _Hook()


def said_when_interrupted(arguments: Sequence[str]) -> str:
    """What is said of a command line that was interrupted: what is left of it, and how it goes on."""
    command = next((word for word in arguments if not word.startswith("-")), "")
    if command in OF_STAGES:
        return "interrupted; finished results are kept, and a long stage continues from its last checkpoint"
    return "interrupted; give the command again: it begins anew" if command in WRITING else "interrupted"


def ended() -> None:
    """No SIGTERM that came before is raised again."""
    while _waiting:
        _waiting.pop().cancel()


def _interrupt(number: int, frame: FrameType | None) -> None:
    _waiting.append(_terminate_after(PATIENCE))
    raise KeyboardInterrupt


def _terminate_after(seconds: float) -> threading.Timer:
    timer = threading.Timer(seconds, os.kill, (os.getpid(), signal.SIGTERM))
    timer.daemon = True
    timer.start()
    return timer


class _Hook:
    def __init__(self) -> None:
        self.before = sys.unraisablehook

    def __call__(self, dropped: sys.UnraisableHookArgs) -> None:
        if issubclass(dropped.exc_type, KeyboardInterrupt):
            _terminate_after(AGAIN)
        else:
            self.before(dropped)
