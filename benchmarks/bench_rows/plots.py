"""Curves of a run as pictures: one file a plot, log-log where sizes vary, a marker a variant where error stands over time."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

MARKERS = "osD^vP*Xd<>p"
MOST_INSIDE = 6  # entries of a legend
DECADES = 1e4  # the least ratio of the ends of an axis of errors


def draw(path: Path, rows: dict[str, dict[str, Any]]) -> list[Path]:
    """Draw the curves of ``rows`` (as in the JSON file); "speed.svg" becomes "speed-over_pixels.svg" and so on. Returns the files."""
    import matplotlib

    matplotlib.use("Agg")
    plots: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for row in rows.values():
        for curve in row.get("curves", ()):  # not every row has some
            plots[curve["plot"]].append(curve)
    path.parent.mkdir(parents=True, exist_ok=True)
    return [_draw_one(path.with_name(f"{path.stem}-{name}{path.suffix}"), curves) for name, curves in plots.items()]


def _draw_one(path: Path, curves: list[dict[str, Any]]) -> Path:
    import matplotlib
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogFormatter

    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.add_subplot()
    drawn: dict[str, tuple[str, Any]] = {}  # marker and colour of each label
    for curve in curves:
        label = curve["label"]
        marker, color = drawn.get(label, (MARKERS[len(drawn) % len(MARKERS)], None))
        style = marker if curve["names"] else "o-"
        (line,) = axes.plot(curve["x"], curve["y"], style, color=color, label=None if label in drawn else label)
        drawn[label] = marker, line.get_color()
        for x, y, name in zip(curve["x"], curve["y"], curve["names"]):
            if name != label:
                axes.annotate(name, (x, y), textcoords="offset points", xytext=(4, 5), fontsize=8, rotation=30)
    axes.set_xscale("log")
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    errors = any(curve["names"] for curve in curves) or "error" in curves[0]["y_title"]
    if errors and high < DECADES * low:
        # Errors within a factor of two of one another are equal; an axis of one decade would tell them apart.
        middle = (low * high) ** 0.5
        axes.set_ylim(middle / DECADES**0.5, middle * DECADES**0.5)
    for axis, values in ((axes.xaxis, [x for c in curves for x in c["x"]]), (axes.yaxis, [y for c in curves for y in c["y"]])):
        if min(values) >= 1 and max(values) < 1e4:  # 20 and 40, not 2 x 10^1 and 4 x 10^1
            axis.set_major_formatter(LogFormatter(labelOnlyBase=False))
            axis.set_minor_formatter(LogFormatter(labelOnlyBase=False, minor_thresholds=(1.5, 0.6)))
    axes.set_xlabel(curves[0]["x_title"])
    axes.set_ylabel(curves[0]["y_title"])
    axes.grid(True, which="both", alpha=0.25)
    if len(drawn) > MOST_INSIDE:
        axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))  # inside it would lie on points
    else:
        axes.legend(fontsize=8)
    # Without a date and with a fixed salt the same numbers give the same file.
    with matplotlib.rc_context({"svg.hashsalt": "e4dgs", "svg.fonttype": "none"}):
        figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None, dpi=150)
    return path
