"""Selects a few items out of many."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

SAMPLE = 16  # training views measured besides the held-out ones; if they are far better, the model has overfitted to its views


FLICKER_CAMERAS, FLICKER_PAIRS = 3, 180  # most cameras of which flicker is measured, and from which number of pairs of times on fewer


LEAST_MEASURED, STEPS_A_VIEW = 32, 50  # by `estimates.py` a view costs about five steps of training: a tenth


def most_measured(asked: int | None, steps: int) -> int:
    """How many views of a split are measured after ``steps`` steps of training, unless a number was asked for."""
    return asked or max(LEAST_MEASURED, steps // STEPS_A_VIEW)


def flicker_cameras(times: int) -> int:
    """Of how many fixed cameras flicker is measured, each at all of its ``times``."""
    return max(1, min(FLICKER_CAMERAS, FLICKER_PAIRS // max(times, 1)))


def spread(items: Sequence[int], count: int) -> list[int]:
    """Up to ``count`` items, evenly spread, including both ends."""
    if len(items) <= count:
        return list(items)
    if count < 2:
        return list(items[:count])
    return [items[round(k * (len(items) - 1) / (count - 1))] for k in range(count)]


def stretches(items: Sequence[int], count: int) -> list[list[int]]:
    """Up to about ``count`` items in stretches of at most 16 neighbours, evenly spread; one stretch of all if they are few."""
    if len(items) <= count:
        return [list(items)]
    longest = min(16, count)
    begins = spread(range(len(items) - longest + 1), max(1, count // longest))
    return [list(items[begin : begin + longest]) for begin in begins]


def worst_and_others(rows: Sequence[Mapping[str, Any]], count: int) -> list[int]:
    """Frames of up to ``count`` of ``rows``, by increasing PSNR: half are the worst ones, the others are spread over the rest."""
    ordered = [int(row["frame"]) for row in sorted(rows, key=lambda row: float(row["psnr"]))]
    worst = (count + 1) // 2
    return ordered[:worst] + spread(ordered[worst:], count - worst)
