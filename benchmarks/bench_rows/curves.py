"""Points of a plot, and what a row yields that has some."""

from __future__ import annotations

from dataclasses import dataclass, field

from e4dgs.workflows.bench.rows import Measured


@dataclass
class Curve:
    """``x`` and ``y`` [n], and a name for each point where points are variants rather than sizes."""

    plot: str
    label: str
    x: list[float]
    y: list[float]
    x_title: str = ""
    y_title: str = ""
    names: list[str] = field(default_factory=list)


@dataclass
class Plotted(Measured):
    """`Measured`, with curves: in the JSON file beside the rest, and drawn by `plots.py`."""

    curves: list[Curve] = field(default_factory=list)
