"""Which few of many are looked at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

SAMPLE = 16  # training views beside the held-out ones: far better ones mean a model that has learned views, not the scene


def spread(items: Sequence[int], count: int) -> list[int]:
    """Up to ``count`` items, evenly spread, ends included."""
    if len(items) <= count:
        return list(items)
    if count < 2:
        return list(items[:count])
    return [items[round(k * (len(items) - 1) / (count - 1))] for k in range(count)]


def worst_and_others(rows: Sequence[Mapping[str, Any]], count: int) -> list[int]:
    """Frames of up to ``count`` of ``rows``, from the lowest PSNR to the highest: half are the worst, the others spread over the rest."""
    ordered = [int(row["frame"]) for row in sorted(rows, key=lambda row: float(row["psnr"]))]
    worst = (count + 1) // 2
    return ordered[:worst] + spread(ordered[worst:], count - worst)
