"""The curves of the report: training over its steps, quality and flicker over the capture's time."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

from .plot import Plot, Series, numbers

SPLITS = ("test", "val", "train")
FLICKER = (("static", "where nothing moves", "a"), ("edges", "at edges", "b"), ("warped", "along the motion", "c"))


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def in_order(splits: Mapping[str, Any]) -> dict[str, Any]:
    """``splits`` with test first, then val, then train."""
    return {name: splits[name] for name in sorted(splits, key=lambda name: SPLITS.index(name) if name in SPLITS else len(SPLITS))}


def training_curves(training: Mapping[str, Mapping[str, Any]]) -> list[Plot]:
    """Loss, PSNR and number of primitives over the steps of all stages, joined one after the other."""
    starts, total = {}, 0.0
    for name, log in training.items():
        starts[name] = total
        steps = [x for key in ("loss", "psnr", "primitives") for x, _ in numbers(log.get(key), 1)]
        given = log.get("iterations")
        total += max([float(given) if is_number(given) else 0.0, *steps])  # type: ignore[arg-type]
    marks = [(start, name) for name, start in starts.items() if start > 0]

    def curve(key: str, column: int) -> list[tuple[float, float]]:
        return [(x + starts[name], y) for name, log in training.items() for x, y in numbers(log.get(key), column)]

    kinds = [Series("Gaussians", curve("primitives", 1), "a"), Series("convexes", curve("primitives", 2), "b")]
    return [
        Plot("Loss", "step", "loss", [Series("loss", curve("loss", 1))], marks, log=True),
        Plot("PSNR of training views", "step", "dB", [Series("PSNR", curve("psnr", 1))], marks),
        Plot("Primitives", "step", "count", kinds, marks),
    ]


def over_time(metrics: Mapping[str, Any]) -> list[Plot]:
    """PSNR of the measured views over time, for splits with several times, and flicker if it was measured. If several cameras share a time,
    the curve shows their mean."""
    found = []
    for split, values in in_order(metrics.get("splits") or {}).items():
        points = _means([(row.get("time"), row.get("psnr")) for row in values.get("per_view") or []])
        if len(points) > 1:
            found.append(Plot(f"PSNR over time, {split}", "time", "dB", [Series(split, points)]))
    pairs = (metrics.get("flicker") or {}).get("per_pair") or []
    curves = [Series(label, _means([(sum(pair["times"]) / 2, pair.get(name)) for pair in pairs]), style) for name, label, style in FLICKER]
    return [*found, Plot("Flicker between neighbouring times", "time", "levels", [curve for curve in curves if curve.points])]


def _means(points: Sequence[tuple[Any, Any]]) -> list[tuple[float, float]]:
    """The mean of the values at each time, in order of time."""
    at: dict[float, list[float]] = defaultdict(list)
    for time, value in numbers(points, 1):
        at[time].append(value)
    return [(time, sum(values) / len(values)) for time, values in sorted(at.items())]
