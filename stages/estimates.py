"""Rough times for the plan, from what is known before anything runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

SECONDS_PER_MEGAPIXEL_STEP = 0.6  # one training step on two cores, measured on the captures of benchmarks/results
MOTION_FACTOR = 1.5


def training_seconds(facts: Mapping[str, Any], iterations: int, static: bool) -> float:
    """Seconds that ``iterations`` steps take on two cores."""
    megapixels = facts.get("width", 0) * facts.get("height", 0) / 1e6
    return iterations * (0.02 + SECONDS_PER_MEGAPIXEL_STEP * megapixels) * (1.0 if static else MOTION_FACTOR)
