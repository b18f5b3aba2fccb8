"""The results of a batch: one row per scene, as CSV, Parquet and a page with the worst scenes first.

``python -m e4dgs.workflows.batch.summary WORKSPACE BATCH`` writes them; the last job of `slurm.py` runs this.
"""

from __future__ import annotations

import csv
import io
import math
import os
import statistics
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...pipeline.files import write_atomically
from ..results import run_command
from .ledger import Ledger

TEMPLATE = Path(__file__).with_name("summary.html.jinja")
METRICS = ("psnr", "ssim", "lpips", "edge_psnr")
COLUMNS = (
    *("scene", "state", "stage", "message", *METRICS, "split", "train_seconds", "seconds", "render_fps", "gaussians", "convexes"),
    *("attempts", "group", "settings", "capture", "report", "player", "command"),
)


def rows_of(ledger: Ledger) -> list[dict[str, Any]]:
    """A row of `COLUMNS` for each scene, in the order of the batch; unknown values are None. The metrics are those of the test views, or
    else of the validation or training views. command: runs this scene again by itself."""
    rows = []
    for entry in ledger.entries():
        progress = ledger.shown(entry.name)
        metrics = ledger.metrics(entry.name) if progress.state == "done" else {}
        splits = metrics.get("splits") or {}
        split = next((name for name in ("test", "val", "train") if name in splits), None)
        values = splits[split] if split is not None else {}
        found: dict[str, Any] = {"scene": entry.name, "state": progress.state, "stage": progress.stage, "message": progress.message}
        found |= {name: values.get(name) for name in METRICS} | {"split": split}
        found |= {name: metrics.get(name) for name in ("train_seconds", "render_fps")} | {"seconds": progress.seconds}
        found |= {name: (metrics.get("primitives") or {}).get(name) for name in ("gaussians", "convexes")}
        settings = " ".join(f"{key}={value}" for key, value in entry.settings)
        found |= {"attempts": progress.attempts, "group": entry.group, "settings": settings, "capture": entry.capture}
        found["command"] = run_command(entry.options(ledger.workspace), "all")
        for name in ("report", "player"):
            page = ledger.workspace / "scenes" / entry.name / f"{name}.html"
            found[name] = os.path.relpath(page, ledger.folder) if page.is_file() else None
        rows.append({name: found[name] for name in COLUMNS})
    return rows


def worst_first(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Failed scenes first, then finished ones by rising PSNR, then unfinished ones."""
    order = {"failed": 0, "done": 1}
    return sorted(rows, key=lambda row: (order.get(row["state"], 2), row["psnr"] if row["psnr"] is not None else math.inf))


def spread(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Mean and standard deviation of PSNR over each group of several scenes. The scenes of a group differ only in their seed."""
    groups: dict[str, list[float]] = defaultdict(list)
    for row in rows:
        if row["psnr"] is not None:
            groups[row["group"]].append(row["psnr"])
    return [
        {"group": name, "runs": len(values), "mean": statistics.fmean(values), "deviation": statistics.stdev(values)}
        for name, values in groups.items()
        if len(values) > 1
    ]


def write_summary(ledger: Ledger) -> Path:
    """Writes ``results.csv``, ``results.parquet`` and ``results.html`` to the batch's folder; returns the path of the page."""
    import pyarrow
    import pyarrow.parquet
    from jinja2 import Environment

    rows = rows_of(ledger)
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, COLUMNS)
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(ledger.folder / "results.csv", text.getvalue())

    numbers = {*METRICS, "train_seconds", "seconds", "render_fps"}
    whole = {"gaussians", "convexes", "attempts"}
    kinds = {True: pyarrow.float64(), False: pyarrow.string()}
    schema = pyarrow.schema([(name, pyarrow.int64() if name in whole else kinds[name in numbers]) for name in COLUMNS])
    table = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.Table.from_pylist(rows, schema), table)
    write_atomically(ledger.folder / "results.parquet", table.getvalue())

    page = ledger.folder / "results.html"
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    counts = {state: sum(row["state"] == state for row in rows) for state in ("done", "failed", "lost", "running", "waiting")}
    counts = {state: count for state, count in counts.items() if count}
    write_atomically(
        page,
        environment.from_string(TEMPLATE.read_text(encoding="utf-8")).render(
            name=ledger.name, command=ledger.command(), rows=worst_first(rows), counts=counts, spread=spread(rows)
        ),
    )
    return page


if __name__ == "__main__":
    print(write_summary(Ledger(Path(sys.argv[1]), sys.argv[2])))
