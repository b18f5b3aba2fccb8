"""Quality against run time of whole runs: every capture at every point of a ladder, in one table and one plot.

A point is what a user would type: the name of a preset, or settings as for `--set`. All runs share a workspace, so poses and flow are made
only once. A run's seconds still count every stage; for a cached stage they are those of the run that made it.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ...pipeline import SettingsError, make_plan
from ..presets import PRESETS
from ..runs import execute
from ..session import SEEDS, Options, open_session
from . import output
from .machine import machine

LADDER = "coarse.effort=0.05,fast,coarse.effort=0.4,default"
HELD_OUT = ("test", "val")
METRICS = ("psnr", "psnr_affine", "ssim", "lpips", "edge_psnr", "psnr_foreground", "psnr_moving", "psnr_static")
Point = tuple[str, str, tuple[str, ...]]  # name, preset, assignments
FLICKER = ("static", "edges", "warped", "flow")


@dataclass
class Run:
    """One run. seconds: wall time of all its stages. metrics: the means in metrics.json, by split. flicker: as in metrics.json."""

    capture: str
    point: str
    seed: int
    seconds: float
    train_seconds: float
    gaussians: int
    convexes: int
    resolution: str
    metrics: dict[str, dict[str, float | None]]
    flicker: dict[str, float | None] = field(default_factory=dict)

    def held_out(self) -> dict[str, float | None]:
        """Metrics of the first held-out split, or of the training views if there is none."""
        return next((self.metrics[split] for split in (*HELD_OUT, *self.metrics) if split in self.metrics), {})


def parse_points(text: str) -> list[Point]:
    """Each point in the comma-separated ``text``: a preset, or settings joined by "+". Raises
    SettingsError."""
    points = []
    for name in filter(None, (part.strip() for part in text.split(","))):
        if "=" in name:
            points.append((name, "default", tuple(name.split("+"))))
        elif name in PRESETS:
            points.append((name, name, ()))
        else:
            raise SettingsError(f"--points {name}: neither a preset ({', '.join(PRESETS)}) nor a setting, as in coarse.effort=0.4")
    if not points:
        raise SettingsError(f"--points {text!r}: there is no point; for example --points {LADDER}")
    return points


def measured(
    captures: Sequence[Path], points: Sequence[Point], seeds: int, options: Options, out: Path | None, console: Console
) -> Iterator[list[Run]]:
    """All runs so far, after each one: a run of each capture at each point with each seed, announced on the ``console`` and written to
    ``out``, so that a failure does not lose earlier ones."""
    jobs, runs = list(product(captures, points, range(seeds))), []
    for number, (capture, point, seed) in enumerate(jobs, 1):
        console.print(f"[{number}/{len(jobs)}] {capture.name}: {point[0]}, seed {seed}", highlight=False, markup=False)
        own = replace(options, capture=capture)
        runs.append(measure(own, point, seed, console, lambda line: console.print("  " + line, markup=False, highlight=False)))
        if out is not None:
            output.write(out, content(runs, machine(), options))
        yield runs


def measure(options: Options, point: Point, seed: int, console: Console, say: Callable[[str], None]) -> Run:
    """Runs everything at ``point``; ``options`` apply to all points."""
    name, preset, assignments = point
    seeds = tuple(f"{setting}={seed}" for setting in SEEDS) if seed else ()
    own = replace(options, choice=replace(options.choice, preset=preset, set=(*options.choice.set, *assignments, *seeds)))
    session = open_session(own)
    slug = "".join(c if c.isalnum() or c in "._-" else "-" for c in f"{session.scene.name}-{name}-{seed}")
    session = open_session(replace(own, name=slug[-100:].lstrip("._-")))
    found = execute(session, make_plan(session.job), console, say)
    assert found is not None
    metrics = found[0]
    primitives = metrics.get("primitives", {})
    return Run(
        capture=options.capture.name,
        point=name,
        seed=seed,
        seconds=round(sum(float(stage["seconds"] or 0.0) for stage in metrics["stages"].values()), 1),
        train_seconds=metrics["train_seconds"],
        gaussians=primitives.get("gaussians", 0),
        convexes=primitives.get("convexes", 0),
        resolution=metrics["protocol"].get("resolution", ""),
        metrics={split: {m: values.get(m) for m in METRICS} for split, values in metrics["splits"].items() if values},
        flicker={name: (metrics.get("flicker") or {}).get(name) for name in FLICKER},
    )


def summaries(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Means over seeds for each capture and point: seconds, held-out metrics, `train_psnr`, and `spread` of PSNR (highest minus lowest)."""
    groups: dict[tuple[str, str], list[Run]] = {}
    for run in runs:
        groups.setdefault((run.capture, run.point), []).append(run)
    rows = []
    for (capture, point), members in groups.items():
        held = [run.held_out() for run in members]
        row: dict[str, Any] = {"capture": capture, "point": point, "seeds": len(members)}
        row["seconds"] = statistics.mean(run.seconds for run in members)
        for metric in METRICS:
            row[metric] = _mean(h.get(metric) for h in held)
        psnr = [value for h in held if (value := h.get("psnr")) is not None]
        row["spread"] = max(psnr) - min(psnr) if psnr else None
        row["train_psnr"] = _mean(run.metrics.get("train", {}).get("psnr") for run in members)
        for name in FLICKER:
            row[f"flicker_{name}"] = _mean(run.flicker.get(name) for run in members)
        row["gaussians"] = round(statistics.mean(run.gaussians for run in members))
        row["convexes"] = round(statistics.mean(run.convexes for run in members))
        rows.append(row)
    return rows


def _mean(values: Iterable[float | None]) -> float | None:
    """Mean of the known values."""
    known = [value for value in values if value is not None]
    return statistics.mean(known) if known else None


def table(rows: Sequence[dict[str, Any]]) -> Table:
    """The table that the command prints."""
    columns = (
        *(("PSNR", "psnr", 2), ("spread", "spread", 2), ("after colour fit", "psnr_affine", 2), ("SSIM", "ssim", 4)),
        *(("LPIPS", "lpips", 4), ("edge PSNR", "edge_psnr", 2), ("train PSNR", "train_psnr", 2), ("flicker at edges", "flicker_edges", 2)),
        ("Gaussians", "gaussians", 0),
    )
    shown = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for title in ("capture", "point", "seconds", *(title for title, _, _ in columns)):
        shown.add_column(title, justify="left" if title in ("capture", "point") else "right")
    for row in rows:
        cells = ["-" if row[key] is None else f"{row[key]:.{digits}f}" for _, key, digits in columns]
        shown.add_row(escape(row["capture"]), escape(row["point"]), f"{row['seconds']:.0f}", *cells)
    return shown


def content(runs: Sequence[Run], facts: dict[str, Any], options: Options) -> dict[str, Any]:
    """The content of the JSON file."""
    protocol = {
        "seconds": "wall time of all stages; a cached stage counts as the run took that made it",
        "metrics": "means over the views of a split; see evaluate; held out is test, else val",
        "settings": list(options.choice.set),
        "device": options.choice.device,
        "static": options.choice.static,
    }
    return {"machine": facts, "protocol": protocol, "points": summaries(runs), "runs": [asdict(run) for run in runs]}


def check_plot(path: Path | None) -> None:
    """Raises SettingsError if the plot cannot be drawn to this file, before hours are spent on its numbers."""
    if path is not None and path.suffix not in (".svg", ".png"):
        raise SettingsError(f"--plot {path}: the file must end in .svg or .png")
    if path is not None and find_spec("matplotlib") is None:
        raise SettingsError("--plot needs the package matplotlib; install it with: pip install 'e4dgs[bench]'")


def draw(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Plots PSNR of held-out views over seconds, one line per capture; dotted lines are training views."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, StrMethodFormatter

    figure = Figure(figsize=(7.2, 4.6), layout="constrained")
    axes = figure.add_subplot()
    for capture in dict.fromkeys(row["capture"] for row in rows):
        points = sorted((r for r in rows if r["capture"] == capture and r["psnr"] is not None), key=lambda r: r["seconds"])
        (line,) = axes.plot([r["seconds"] for r in points], [r["psnr"] for r in points], "o-", label=capture)
        train = [r for r in points if r["train_psnr"] is not None]
        axes.plot([r["seconds"] for r in train], [r["train_psnr"] for r in train], ":.", color=line.get_color())
        for r in points:
            axes.annotate(r["point"], (r["seconds"], r["psnr"]), textcoords="offset points", xytext=(4, -10), fontsize=7)
    axes.set_xscale("log")
    axes.xaxis.set_minor_locator(LogLocator(subs=(2, 3, 5)))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.xaxis.set_minor_formatter(StrMethodFormatter("{x:g}"))
    axes.set_xlabel("seconds, all stages")
    axes.set_ylabel("PSNR of held-out views, dB (dotted: training views)")
    axes.grid(True, which="both", alpha=0.25)
    axes.legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context({"svg.hashsalt": "e4dgs", "svg.fonttype": "none"}):
        figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None, dpi=150)
