"""The output of a benchmark: a table of checks with their bars, and JSON that includes how they were measured."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ...pipeline.files import write_atomically
from .rows import Bench, Check, Measured, Row

PASSED = {True: "[green]pass[/]", False: "[red]miss[/]", None: ""}


def number(value: float, unit: str) -> str:
    """A number with three digits, or with an exponent if it is below 0.01."""
    shown = f"{value:.1e}" if value and abs(value) < 0.01 else f"{value:.3g}" if abs(value) < 1000 else f"{value:,.0f}"
    return shown + ("x" if unit == "x" else f" {unit}" if unit else "")


def bar(check: Check) -> str:
    if check.bar is None:
        return ""
    return f"{'≤' if check.better == 'below' else '≥'} {number(check.bar, check.unit)}"


def show_row(console: Console, row: Row, measured: Measured, judged: bool) -> None:
    """Prints the checks of a row and its further numbers. Without ``judged``, sizes are not those of the bars, so nothing is judged."""
    console.print(f"[bold]{row.name}[/]  {escape(measured.protocol)}", highlight=False, soft_wrap=True)
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 2), show_header=False)
    for check in measured.checks:
        verdict = PASSED[check.passed] if judged or check.bar is None else "[dim]not judged[/]"
        table.add_row(escape(check.what), number(check.value, check.unit), bar(check), verdict, escape(check.note))
    if measured.checks:
        console.print(table)
    if measured.table:
        more = Table(box=None, pad_edge=False, padding=(0, 2, 0, 2))
        for column in measured.columns:
            more.add_column(column, justify="left" if column == measured.columns[0] else "right")
        for cells in measured.table:
            more.add_row(*map(escape, cells))
        console.print(more)


def row_json(row: Row, measured: Measured) -> dict[str, Any]:
    """A row of the JSON file: everything that was measured, and whether each bar is met."""
    checks = [vars(check) | {"passed": check.passed} for check in measured.checks]
    return {"what": row.what} | asdict(measured) | {"checks": checks}


def report(suite: str, bench: Bench, facts: dict[str, Any], rows: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """The JSON file of one run."""
    protocol = {
        "suite": suite,
        "scale": bench.scale,
        "judged": bench.scale == 1,
        "repeats": bench.repeats,
        "seconds_a_contender": bench.seconds,
        "garden": bench.garden.name if bench.garden else None,
        "capture": bench.capture.name if bench.capture else None,
        "timing": "wall time, one warm-up, contenders in turns; ratios by the best run of each",
    }
    return {"machine": facts, "protocol": protocol, "rows": rows}


def write(path: Path, content: dict[str, Any]) -> None:
    """Writes JSON atomically, because it is written again after each row and the rows before must not be lost. Numbers that are not finite
    become null, since JSON cannot hold them."""
    write_atomically(path, json.dumps(_finite(content), indent=1, ensure_ascii=False) + "\n")


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
