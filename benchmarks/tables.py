"""The tables of measured figures on the pages: `benchmarks/publish.py` writes them.

Between the lines `<!-- NAME -->` and `<!-- end -->` of a page everything is replaced: by a table of `quality_tables.py`, or by those of
benchmarks/results/bench_NAME.json, as `benchmarks/bench.py NAME --out` and `benchmarks/knobs.py --out` write it; its plots go to plots/.
Nothing else is touched; a result that is absent leaves one line that says how to make it.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

from e4dgs.workflows.bench.output import number
from quality_tables import TABLES

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
PLOTS = RESULTS / "plots"
PAGES = ("README.md", "docs/hardware.md", "benchmarks/results/benchmarks.md")
COMMANDS = {
    "raster": "python benchmarks/bench.py raster --garden FILE --out benchmarks/results/bench_raster.json",
    "field": "python benchmarks/bench.py field --out benchmarks/results/bench_field.json",
    "step": "python benchmarks/bench.py step --capture CAPTURE --out benchmarks/results/bench_step.json",
    "cuda": "python benchmarks/bench.py cuda --garden FILE --out benchmarks/results/bench_cuda.json",
    "rig": "e4dgs bench step --capture RIG --out benchmarks/results/bench_rig.json",
    "flow": "python benchmarks/flow.py SCENES --weights DIR --out benchmarks/results/bench_flow.json",
    "flow_terms": "python benchmarks/flow_terms.py SCENES --out benchmarks/results/bench_flow_terms.json",
    "knobs": "python benchmarks/knobs.py --out benchmarks/results/bench_knobs.json",
}


def section(name: str, draw: bool = True) -> str:
    """The tables of a bench, its machine above them, its plots below."""
    path = RESULTS / f"bench_{name}.json"
    if not path.is_file():
        return f"Not measured yet: `{COMMANDS[name]}`."
    result = json.loads(path.read_text())
    facts = result["machine"]
    lines = [
        f"{facts['processor']}, {facts['cores']} cores, {facts['threads']} threads, {facts['kernels']} kernels; {facts['compiler']}; "
        f"torch {facts['versions']['torch']}; {facts['date']}, commit {facts['commit']}.",
    ]
    if not result["protocol"].get("judged", True):
        lines += ["", f"**Sizes are {result['protocol']['scale']} of the full ones; no bar is judged.**"]
    for row, found in result["rows"].items():
        lines += ["", f"**{row}**: {found['protocol']}", ""]
        if found["checks"]:
            lines += ["| what | measured | bar | |", "|---|---|---|---|", *(check_row(check) for check in found["checks"]), ""]
        if found["table"]:
            columns = [column or " " for column in found["columns"]]
            lines += ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
            lines += ["| " + " | ".join(cells) + " |" for cells in found["table"]]
    plots = draw_plots(name, result["rows"]) if draw else sorted(PLOTS.glob(f"{name}-*.svg"))
    lines += [""] + [f"![{plot.stem}](plots/{plot.name})" for plot in plots]
    return "\n".join(lines).rstrip()


def check_row(check: dict) -> str:
    value = "not finite" if check["value"] is None else number(check["value"], check["unit"])
    bar, verdict = "", ""
    if check["bar"] is not None:
        bar = ("≤ " if check["better"] == "below" else "≥ ") + number(check["bar"], check["unit"])
        verdict = "pass" if check["passed"] else "**miss**"
    what = check["what"] + (f" ({check['note']})" if check["note"] else "")
    return f"| {what.replace('|', '/')} | {value} | {bar} | {verdict} |"


def draw_plots(name: str, rows: dict) -> list[Path]:
    from bench_rows.plots import draw

    return sorted(draw(PLOTS / f"{name}.svg", rows))


def page(text: str, draw: bool = True) -> str:
    """The page with every marked part replaced."""
    return re.sub(
        r"<!-- (\w+) -->\n.*?<!-- end -->",
        lambda match: f"<!-- {match[1]} -->\n{TABLES[match[1]]() if match[1] in TABLES else section(match[1], draw)}\n<!-- end -->",
        text,
        flags=re.DOTALL,
    )


def write(check: bool) -> None:
    """Writes the pages. check: changes nothing, and raises SystemExit if one is not what the results say."""
    for name in PAGES:
        before = (ROOT / name).read_text()
        if page(before, draw=False) == before:
            continue
        if check:
            raise SystemExit(f"{name} is not what its results say; run python benchmarks/publish.py")
        (ROOT / name).write_text(page(before))
