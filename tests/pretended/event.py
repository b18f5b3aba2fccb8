"""A mark in the work of the device that is pretended."""

from __future__ import annotations

from typing import Any

from . import syncs


class Event:
    """Has happened when it is asked for the second time: the device is a little behind. Waiting for it before that is a wait."""

    def __init__(self, *given: Any, **named: Any) -> None:
        self._asked = self._happened = False

    def record(self, stream: Any = None) -> None:
        self._asked = self._happened = False

    def query(self) -> bool:
        self._happened, self._asked = self._asked, True
        return self._happened

    def synchronize(self) -> None:
        if not self._happened:
            syncs.note("synchronize")
        self._asked = self._happened = True
