"""Curves of a run as pictures: one file a plot, log-log where sizes vary, a marker a variant where error stands over time."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

MARKERS = "osD^vP*Xd<>p"


def draw(path: Path, rows: dict[str, dict[str, Any]]) -> list[Path]:
    """Draw the curves of ``rows`` (as in the JSON file); "speed.svg" becomes "speed-over_pixels.svg" and so on. Returns the files."""
    import matplotlib

    matplotlib.use("Agg")
    plots: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for row in rows.values():
        for curve in row["curves"]:
            plots[curve["plot"]].append(curve)
    path.parent.mkdir(parents=True, exist_ok=True)
    return [_draw_one(path.with_name(f"{path.stem}-{name}{path.suffix}"), curves) for name, curves in plots.items()]


def _draw_one(path: Path, curves: list[dict[str, Any]]) -> Path:
    import matplotlib
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.add_subplot()
    labels: dict[str, Any] = {}
    for curve in curves:
        if curve["names"]:
            marker = MARKERS[len(labels) % len(MARKERS)]
            points = axes.plot(curve["x"], curve["y"], marker, label=curve["label"], color=labels.get(curve["label"]))
            for x, y, name in zip(curve["x"], curve["y"], curve["names"]):
                if name != curve["label"]:
                    axes.annotate(name, (x, y), textcoords="offset points", xytext=(6, 4), fontsize=8)
        else:
            points = axes.plot(curve["x"], curve["y"], "o-", label=curve["label"])
        labels.setdefault(curve["label"], points[0].get_color())
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel(curves[0]["x_title"])
    axes.set_ylabel(curves[0]["y_title"])
    axes.grid(True, which="both", alpha=0.25)
    axes.legend(fontsize=8)
    # Without a date and with a fixed salt the same numbers give the same file.
    with matplotlib.rc_context({"svg.hashsalt": "e4dgs", "svg.fonttype": "none"}):
        figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None, dpi=150)
    return path
