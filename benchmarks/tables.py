"""Writes the tables and plots of benchmarks/results/benchmarks.md: `python benchmarks/tables.py [--check]`.

Between the lines `<!-- NAME -->` and `<!-- end -->` of the page everything is replaced by the tables of benchmarks/results/bench_NAME.json,
as `benchmarks/bench.py NAME --out` and `benchmarks/knobs.py --out` write it, and plots go to plots/ beside it. Nothing else is touched; a
result that is absent leaves one line that says how to make it. --check changes nothing and exits 1 where the page is not what it would
write.
"""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path

from e4dgs.workflows.bench.output import number

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
PAGE, PLOTS = RESULTS / "benchmarks.md", RESULTS / "plots"
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
    """The tables of one result, its machine above them, its plots below."""
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
        lambda match: f"<!-- {match[1]} -->\n{section(match[1], draw)}\n<!-- end -->",
        text,
        flags=re.DOTALL,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    args = parser.parse_args()
    before = PAGE.read_text()
    after = page(before, draw=not args.check)
    if args.check:
        raise SystemExit(0 if after == before else f"{PAGE} is not what its results say; run python benchmarks/tables.py")
    PAGE.write_text(after)


if __name__ == "__main__":
    main()
