"""Measures the chosen rows of a suite one after another, and prints and writes each immediately."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from ...pipeline import Progress, SettingsError, say
from . import output
from .machine import kernels, machine
from .rows import Bench, Row, choose


def run(
    suite: str, rows: Sequence[Row], bench: Bench, *, names: str | None, only_list: bool, threads: int, out: Path | None, console: Console
) -> dict[str, Any]:
    """The measured rows by name, as in the JSON file. ``names``: comma-separated; None for all. ``only_list``: measure nothing."""
    if bench.garden is not None and not bench.garden.is_file():
        raise SettingsError(f"--garden {bench.garden}: there is no such file")
    if out is not None and out.is_dir():
        raise SettingsError(f"--out {out}: this is a folder; name a file, for example {out / f'{suite}.json'}")
    if only_list:
        say(*(f"{row.name:12} {row.what}" for row in rows), to=console)
        return {}
    chosen = choose(rows, names)

    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(threads or before)
    measured: dict[str, Any] = {}
    try:
        facts = machine() | kernels()
        if bench.scale != 1:
            console.print(f"sizes are {bench.scale:g} of the full ones: bars are shown, but nothing is judged", highlight=False)
        for row in chosen:
            with Progress(0, row.name, console) as bench.progress:
                found = row.measure(bench)
            output.show_row(console, row, found, bench.scale == 1)
            measured[row.name] = output.row_json(row, found)
            if out is not None:
                output.write(out, output.report(suite, bench, facts, measured))
    finally:
        torch.set_num_threads(before)
    if out is not None:
        say(f"numbers: {out}", to=console)
    return measured
