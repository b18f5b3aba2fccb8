"""`e4dgs bench ablation`: the rows of the paper's Table 3 on your own captures, over seeds, as one table."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from ...pipeline import SettingsError, say
from ...pipeline.files import write_atomically
from ...stages.hulls.defaults import CONVEXES
from ..machine.places import typed_path
from ..machine.terminal import make_console
from ..options import Captures, of_captures
from ..session import Options
from .pipeline import measured, summaries, table

NO_DATA, NO_INTERVAL = ("train.data_flow_weight=0",), ("train.interval_weight=0",)
INTERVAL = ("train.interval_weight=0.001",)  # by default, only planes have it
NO_CONVEXES, CONVEX = ("hulls.budget=0",), (f"hulls.budget={CONVEXES}",)  # by default, captures with control nodes get none
ROWS: Mapping[str, tuple[str, ...]] = {
    "a, base": (*NO_DATA, *NO_INTERVAL, *NO_CONVEXES),
    "b, convexes": (*NO_DATA, *NO_INTERVAL, *CONVEX),
    "c, edges at time steps": (*NO_INTERVAL, *NO_CONVEXES),
    "d, edges and interval": (*INTERVAL, *NO_CONVEXES),
    "full": (*INTERVAL, *CONVEX),
    "full resolution": ("coarse.full_from=0",),
    "joint": ("coarse.strategy=joint",),
    "alternating": ("coarse.strategy=alternating",),
    "progressive": ("coarse.strategy=progressive",),
    "two-stage": ("coarse.strategy=two-stage",),
}
COLUMNS = {
    "capture": "capture",
    "point": "row",
    "seeds": "seeds",
    "psnr": "PSNR",
    "spread": "spread",
    "ssim": "SSIM",
    "lpips": "LPIPS",
    "edge_psnr": "edge PSNR",
    "flicker_static": "flicker, static",
    "flicker_edges": "flicker, edges",
    "flicker_warped": "flicker, along motion",
    "flicker_flow": "tOF, px",
    "seconds": "seconds",
    "gaussians": "Gaussians",
    "convexes": "convexes",
}
DIGITS = {"ssim": 4, "lpips": 4, "seconds": 0, "gaussians": 0, "convexes": 0, "seeds": 0}
PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>Ablation</title>
<style>:root { color-scheme: light dark } body { font: 15px/1.5 sans-serif; margin: 2em auto; max-width: 75em; padding: 0 1em }
table { border-collapse: collapse } td, th { padding: .3em .8em; text-align: right; border-bottom: 1px solid #8885 }
td:nth-child(-n+2), th:nth-child(-n+2) { text-align: left }</style></head><body><h1>Ablation</h1>
<p>Means over seeds; the spread is the highest PSNR minus the lowest. Held-out views: test, else validation. Flicker in levels of 8 bits
and tOF, for captures of fixed cameras. Seconds of all stages; a cached stage counts as the run took that made it. {{ note }}</p>
<table><tr>{% for title in titles %}<th>{{ title }}</th>{% endfor %}</tr>
{% for row in rows %}<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>
{% endfor %}</table></body></html>
"""


@of_captures("seed", "store_also")
def ablation(
    captures: Captures,
    out: Annotated[Path, typer.Option("--out", parser=typed_path, metavar="DIR", help="Where ablation.csv, .html and .json go.")],
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Runs of each row; the tables show mean and spread.")] = 1,
    rows: Annotated[
        str | None, typer.Option("--rows", metavar="NAME,NAME", help="Only rows whose names begin like this: a,b,full.")
    ] = None,
    *,
    options: Options,
) -> None:
    """Run the rows of the paper's Table 3 (convexes, edge terms, strategies) on captures. Stages on which rows agree run once."""
    console = make_console()
    chosen = choose(rows)
    points = [(name, options.choice.preset, ROWS[name]) for name in chosen]
    for runs in measured(captures, points, seeds, options, out / "ablation.json", console):
        write(out, summaries(runs), f"Preset {options.choice.preset}. {' '.join(options.choice.set)}")
    console.print(table(summaries(runs)))
    say(f"table: {out / 'ablation.html'}", to=console)


def choose(names: str | None) -> list[str]:
    """The rows whose names begin with an entry of a comma-separated list; all for None. Raises SettingsError for an entry without a row."""
    if names is None:
        return list(ROWS)
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    for name in wanted:
        if not any(_begins(row, name) for row in ROWS):
            raise SettingsError(f"--rows {name}: there is no such row; rows: {'; '.join(ROWS)}")
    return [row for row in ROWS if any(_begins(row, name) for name in wanted)]


def _begins(row: str, name: str) -> bool:
    return row == name or row.startswith(name + ",")


def write(folder: Path, rows: Sequence[Mapping[str, Any]], note: str) -> None:
    """Writes ``ablation.csv``, with every digit, and ``ablation.html``."""
    from jinja2 import Environment

    folder.mkdir(parents=True, exist_ok=True)
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, COLUMNS, extrasaction="ignore")
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(folder / "ablation.csv", text.getvalue())
    shown = [[_cell(key, row.get(key)) for key in COLUMNS] for row in rows]
    page = Environment(autoescape=True).from_string(PAGE).render(titles=COLUMNS.values(), rows=shown, note=note)
    write_atomically(folder / "ablation.html", page)


def _cell(key: str, value: Any) -> str:
    if value is None:
        return "-"
    return value if isinstance(value, str) else f"{value:.{DIGITS.get(key, 2)}f}"
