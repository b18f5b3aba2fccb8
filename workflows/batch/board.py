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


def table(ledger: Ledger) -> Table:
    """Scene, state, stage, how far, time spent; running and failed scenes first."""
    found = [(entry.name, ledger.progress(entry.name)) for entry in ledger.entries()]
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
    if console.is_terminal:
        with Live(table(ledger), console=console, refresh_per_second=2) as live:
            while not ended():
                time.sleep(EVERY)
                live.update(table(ledger))
            live.update(table(ledger))
        return
    said: dict[str, tuple[str, str]] = {}
    names = [entry.name for entry in ledger.entries()]
    while True:
        last = ended()
        for name in names:
            progress = ledger.progress(name)
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
