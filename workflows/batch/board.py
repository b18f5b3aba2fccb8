"""The state of a batch as a table for people: live in a terminal, a line for each change in a log."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.table import Table

from ...pipeline import duration
from .ledger import Ledger, Progress

EVERY = 1.0  # s between two looks
TAIL = 2000  # bytes of a log that are read for how far a stage is
MOST_ROWS = 40  # of a table: what is done is counted, not listed
ORDER = ("running", "failed", "waiting", "done")
_LEFT = re.compile(r"\((\d+) %\), ([^,\n]*) left")


def how_far(log: Path) -> str:
    """What the running stage said last about itself: percent and time left, "" where it said nothing yet."""
    try:
        with open(log, "rb") as file:
            file.seek(max(0, os.path.getsize(log) - TAIL))
            said = file.read().decode(errors="replace")
    except OSError:
        return ""
    found = _LEFT.findall(said.rpartition("\n== ")[2])
    return f"{found[-1][0]} %, {found[-1][1]} left" if found else ""


class States:
    """The states of a batch's scenes, looked at again and again: the list is read once, and a scene that is done not any more."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self._names = [entry.name for entry in ledger.entries()]
        self._done: dict[str, Progress] = {}

    def now(self) -> list[tuple[str, Progress]]:
        """Of all scenes, in the order of the batch."""
        found = []
        for name in self._names:
            progress = self._done.get(name) or self._ledger.progress(name)
            if progress.state == "done":
                self._done[name] = progress
            found.append((name, progress))
        return found


def table(ledger: Ledger, states: States | None = None) -> Table:
    """Scene, state, stage, how far, time spent; running and failed scenes first. ``states``: of who shows it again and again."""
    found = (states or States(ledger)).now()
    found.sort(key=lambda item: ORDER.index(item[1].state))
    counts = [f"{n} {state}" for state in ORDER if (n := sum(p.state == state for _, p in found))]
    shown = Table(title=f"{ledger.name}: {', '.join(counts)}", title_justify="left", box=None, pad_edge=False)
    for title in ("scene", "state", "stage", "time", ""):
        shown.add_column(title, overflow="fold")
    for name, progress in found[:MOST_ROWS]:
        colour = {"running": "cyan", "failed": "red", "done": "green"}.get(progress.state, "")
        detail = how_far(ledger.log(name)) if progress.state == "running" else progress.message
        shown.add_row(name, f"[{colour}]{progress.state}[/]" if colour else progress.state, progress.stage, _time(progress), _plain(detail))
    if len(found) > MOST_ROWS:
        shown.add_row(f"and {len(found) - MOST_ROWS} more", "", "", "", "")
    return shown


def watch(ledger: Ledger, console: Console, ended: Callable[[], bool]) -> None:
    """Show the batch until ``ended``."""
    states = States(ledger)
    if console.is_terminal:
        with Live(table(ledger, states), console=console, refresh_per_second=2) as live:
            while not ended():
                time.sleep(EVERY)
                live.update(table(ledger, states))
            live.update(table(ledger, states))
        return
    said: dict[str, tuple[str, str]] = {}
    while True:
        last = ended()
        for name, progress in states.now():
            now = progress.state, progress.stage
            if said.get(name) != now and progress.state != "waiting":
                said[name] = now
                detail = f": {progress.message}" if progress.message else ""
                console.print(_plain(f"{name}: {progress.state} {progress.stage}".rstrip() + detail), highlight=False, soft_wrap=True)
        if last:
            return
        time.sleep(EVERY)


def _time(progress: Progress) -> str:
    spent = progress.seconds + (time.time() - progress.changed if progress.state == "running" else 0.0)
    return duration(spent) if spent else ""


def _plain(text: str) -> str:
    return text.replace("[", r"\[")
