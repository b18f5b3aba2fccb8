"""Shows the state of a batch to people: as a live table in a terminal, or as one line per change in a log."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.table import Table

from ...pipeline import duration, say
from .ledger import Ledger, SceneState

EVERY = 1.0  # s between two updates
TAIL = 2000  # bytes at the end of a log that are read for a stage's progress
MOST_ROWS = 40  # of a table; further scenes are counted, not listed
ORDER = ("running", "lost", "failed", "waiting", "done")
EVERY_LINE = 60.0  # s between two log lines about the whole batch
_LEFT = re.compile(r"\((\d+) %\), ([^,\n]*) left")


def how_far(log: Path) -> str:
    """The progress that the running stage last reported: percent and time left; "" if it has reported nothing yet."""
    try:
        with open(log, "rb") as file:
            file.seek(max(0, os.path.getsize(log) - TAIL))
            said = file.read().decode(errors="replace")
    except OSError:
        return ""
    found = _LEFT.findall(said.rpartition("\n== ")[2])
    return f"{found[-1][0]} %, {found[-1][1]} left" if found else ""


class States:
    """The states of a batch's scenes, for repeated queries. The list is read only once, and a finished scene is not read again."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self._names = [entry.name for entry in ledger.entries()]
        self._done: dict[str, SceneState] = {}

    def now(self) -> list[tuple[str, SceneState]]:
        """States of all scenes, in the order of the batch."""
        found = []
        for name in self._names:
            progress = self._done.get(name) or self._ledger.shown(name)
            if progress.state == "done":
                self._done[name] = progress
            found.append((name, progress))
        return found


class Pace:
    """Estimates how long a batch still takes, from the scenes that have ended since this was created."""

    def __init__(self, states: States) -> None:
        self._began, self._before = time.monotonic(), self._ended(states.now())

    def left(self, found: Sequence[tuple[str, SceneState]]) -> str:
        """The time left, in words; "" until a scene has ended."""
        ended = self._ended(found)
        if ended == self._before or ended == len(found):
            return ""
        seconds = (time.monotonic() - self._began) / (ended - self._before) * (len(found) - ended)
        return f"; about {duration(seconds)} left"

    @staticmethod
    def _ended(found: Sequence[tuple[str, SceneState]]) -> int:
        return sum(progress.state in ("done", "failed") for _, progress in found)


def counts(ledger: Ledger, found: Sequence[tuple[str, SceneState]], pace: Pace | None = None) -> str:
    """The batch in one line."""
    parts = [f"{n} {state}" for state in ORDER if (n := sum(p.state == state for _, p in found))]
    return f"{ledger.name}: {', '.join(parts)}" + (pace.left(found) if pace is not None else "")


def table(ledger: Ledger, states: States | None = None, pace: Pace | None = None) -> Table:
    """Scene, state, stage, time spent and progress; running and failed scenes first. ``states``, ``pace``: to reuse for repeated tables."""
    found = (states or States(ledger)).now()
    found.sort(key=lambda item: ORDER.index(item[1].state))
    shown = Table(title=escape(counts(ledger, found, pace)), title_justify="left", box=None, pad_edge=False)
    for title in ("scene", "state", "stage", "time", "time left, or message"):
        shown.add_column(title, overflow="fold")
    for name, progress in found[:MOST_ROWS]:
        colour = {"running": "cyan", "failed": "red", "lost": "red", "done": "green"}.get(progress.state, "")
        detail = how_far(ledger.log(name)) if progress.state == "running" else progress.message
        shown.add_row(name, f"[{colour}]{progress.state}[/]" if colour else progress.state, progress.stage, _time(progress), escape(detail))
    if len(found) > MOST_ROWS:
        shown.add_row(f"and {len(found) - MOST_ROWS} more", "", "", "", "")
    return shown


def watch(ledger: Ledger, console: Console, ended: Callable[[], bool]) -> None:
    """Shows the batch until ``ended``."""
    states = States(ledger)
    pace = Pace(states)
    if console.is_terminal and not console.is_dumb_terminal:  # in a dumb one a live table shows nothing until its end
        with Live(table(ledger, states, pace), console=console, refresh_per_second=2) as live:
            while not ended():
                time.sleep(EVERY)
                live.update(table(ledger, states, pace))
            live.update(table(ledger, states, pace))
        return
    said: dict[str, tuple[str, str]] = {}
    line = time.monotonic()
    while True:
        last = ended()
        found = states.now()
        for name, progress in found:
            now = progress.state, progress.stage
            if said.get(name) != now and progress.state != "waiting":
                said[name] = now
                detail = f": {progress.message}" if progress.message else ""
                say(f"{name}: {progress.state} {progress.stage}".rstrip() + detail, to=console)
        if last:
            return
        if time.monotonic() - line > EVERY_LINE:
            line = time.monotonic()
            running = [item for item in found if item[1].state == "running"]
            far = [f"{name} {progress.stage} {how_far(ledger.log(name))}".rstrip() for name, progress in running]
            say(" | ".join([counts(ledger, found, pace), *far]), to=console)
        time.sleep(EVERY)


def _time(progress: SceneState) -> str:
    spent = progress.seconds + (time.time() - progress.changed if progress.state == "running" else 0.0)
    return duration(spent) if spent else ""
