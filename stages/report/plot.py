"""Line plots as inline SVG text, so that the report needs neither a plotting library nor the network."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

WIDTH, HEIGHT = 420, 230
LEFT, RIGHT, TOP, BOTTOM = 56, 12, 14, 34
CHARACTER = 7.2  # px at most of a digit of a tick's text, which is 11 px high, in the fonts that browsers use
LEAST_TICKS = 3  # on the x axis
MOST_POINTS = 600  # per polyline; longer curves are thinned, keeping both ends


@dataclass
class Series:
    """A curve: ``points`` are (x, y); ``style`` is the CSS class a, b or c that colours it."""

    label: str
    points: list[tuple[float, float]]
    style: str = "a"


@dataclass
class Plot:
    """Curves over one x axis. marks: x values where a stage begins, with its name. log: logarithmic y axis (values <= 0 are left out)."""

    title: str
    x_label: str
    y_label: str
    series: Sequence[Series]
    marks: Sequence[tuple[float, str]] = field(default_factory=list)
    log: bool = False


def numbers(rows: Any, column: int) -> list[tuple[float, float]]:
    """(row[0], row[column]) of every row in which both are finite numbers; anything else is left out."""
    found = []
    for row in rows if isinstance(rows, list | tuple) else ():
        try:
            x, y = float(row[0]), float(row[column])
        except (TypeError, ValueError, IndexError, KeyError):
            continue
        if math.isfinite(x) and math.isfinite(y):
            found.append((x, y))
    return found


def svg(plot: Plot) -> str:
    """The plot as one <svg> element; "" if no curve has two points."""
    series = [Series(s.label, _thin([p for p in s.points if not plot.log or p[1] > 0]), s.style) for s in plot.series]
    series = [s for s in series if len(s.points) >= 2]
    if not series:
        return ""
    xs = [x for s in series for x, _ in s.points]
    ys = [y for s in series for _, y in s.points]
    x_low, x_high = min(xs), max(max(xs), min(xs) + 1e-9)
    scale = math.log10 if plot.log else float
    y_ticks = _log_ticks(min(ys), max(ys)) if plot.log else _ticks(min(ys), max(ys))
    y_low, y_high = min(scale(min(ys)), scale(y_ticks[0])), max(scale(max(ys)), scale(y_ticks[-1]))
    y_high = max(y_high, y_low + 1e-9)

    y_texts = [_labels([tick])[0] for tick in y_ticks] if plot.log else _labels(y_ticks)
    left = max(LEFT, 24 + CHARACTER * max(map(len, y_texts)))  # right of the axis' own text

    def place(x: float, y: float) -> tuple[float, float]:
        across = left + (x - x_low) / (x_high - x_low) * (WIDTH - left - RIGHT)
        return across, HEIGHT - BOTTOM - (scale(y) - y_low) / (y_high - y_low) * (HEIGHT - TOP - BOTTOM)

    parts = [f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(plot.title)}">']
    for tick, text in zip(y_ticks, y_texts):
        _, y = place(x_low, tick)
        parts.append(f'<line class="grid" x1="{left:g}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text class="tick" x="{left - 6:g}" y="{y + 3.5:.1f}" text-anchor="end">{text}</text>')
    x_ticks = _inside(x_low, x_high)
    for tick, text in zip(x_ticks, _labels(x_ticks)):
        x, _ = place(tick, ys[0])
        half = 0.5 * CHARACTER * len(text)  # the text stays inside the picture
        x = min(max(x, half), WIDTH - half)
        parts.append(f'<text class="tick" x="{x:.1f}" y="{HEIGHT - BOTTOM + 15}" text-anchor="middle">{text}</text>')
    for at, label in plot.marks:
        if x_low < at < x_high:
            x, _ = place(at, ys[0])
            parts.append(f'<line class="mark" x1="{x:.1f}" x2="{x:.1f}" y1="{TOP}" y2="{HEIGHT - BOTTOM}"/>')
            parts.append(f'<text class="tick" x="{x + 4:.1f}" y="{TOP + 9}">{escape(label)}</text>')
    for s in series:
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in (place(*p) for p in s.points))
        parts.append(f'<polyline class="curve {escape(s.style)}" points="{path}"><title>{escape(s.label)}</title></polyline>')
    parts.append(
        f'<text class="tick" x="{(left + WIDTH - RIGHT) / 2:g}" y="{HEIGHT - 4}" text-anchor="middle">{escape(plot.x_label)}</text>'
    )
    middle = (TOP + HEIGHT - BOTTOM) / 2
    parts.append(
        f'<text class="tick" x="12" y="{middle}" text-anchor="middle" transform="rotate(-90 12 {middle})">{escape(plot.y_label)}</text>'
    )
    return "".join([*parts, "</svg>"])


def _thin(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    if len(points) <= MOST_POINTS:
        return points
    step = (len(points) - 1) / (MOST_POINTS - 1)
    return [points[round(k * step)] for k in range(MOST_POINTS)]


def _ticks(low: float, high: float, count: int = 4) -> list[float]:
    """Round values that span [low, high] with a step of 1, 2 or 5 times a power of ten."""
    span = max(high - low, abs(high) * 1e-6, 1e-9)
    power = 10.0 ** math.floor(math.log10(span / count))
    step = next(power * k for k in (1, 2, 5, 10) if power * k * count >= span * 0.999)
    first = math.floor(low / step + 1e-9)
    last = math.ceil(high / step - 1e-9)
    return [k * step for k in range(first, max(last, first + 1) + 1)]


def _log_ticks(low: float, high: float) -> list[float]:
    steps = [m * 10.0**e for e in range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1) for m in (1, 2, 5)]
    inside = [v for v in steps if low * 0.999 <= v <= high * 1.001]
    if len(inside) > 6:
        inside = [v for v in inside if math.isclose(math.log10(v), round(math.log10(v)), abs_tol=1e-9)]
    below, above = [v for v in steps if v <= low], [v for v in steps if v >= high]
    return inside if len(inside) >= 2 else [below[-1] if below else low, above[0] if above else high]


def _inside(low: float, high: float) -> list[float]:
    """Round values in [low, high], at least `LEAST_TICKS` and as few as that allows, with one step; both ends if there are none."""
    for count in range(4, 16):
        margin = 1e-6 * (high - low)
        found = [tick for tick in _ticks(low, high, count) if low - margin <= tick <= high + margin]
        if len(found) >= LEAST_TICKS:
            return found
    return [low, high]


def _labels(ticks: Sequence[float]) -> list[str]:
    """The ticks as text, with as many digits as tell them apart."""
    largest = max(abs(tick) for tick in ticks)
    unit, ending = next(((u, e) for u, e in ((1e9, "G"), (1e6, "M"), (1e4, "k")) if largest >= u), (1.0, ""))
    unit = 1e3 if ending == "k" else unit
    for digits in range(4, 12):
        texts = [f"{tick / unit:.{digits}g}" for tick in ticks]
        if len(set(texts)) == len(texts) and all(
            math.isclose(float(t) * unit, v, rel_tol=1e-6, abs_tol=1e-12) for t, v in zip(texts, ticks)
        ):
            break
    return [text if text == "0" else text + ending for text in texts]
