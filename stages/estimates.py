"""Rough times for the plan, from what is known before anything runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# One training step on two cores, fitted to the captures of benchmarks/results; the motion costs the same at any image size.
SECONDS_PER_MEGAPIXEL_STEP = 0.35
SECONDS_PER_STEP = 0.03
SECONDS_PER_STATIC_STEP = 0.01
SECONDS_PER_NODE_STEP = 0.014
SECONDS_PER_MEGAPIXEL_NODE_STEP = 0.1  # of which a window around the object is looked at


def training_seconds(facts: Mapping[str, Any], iterations: int, static: bool, area: float = 1.0) -> float:
    """Seconds that ``iterations`` steps take on two cores. area: of the images in use, as a mean share of the full ones."""
    megapixels = facts.get("width", 0) * facts.get("height", 0) / 1e6
    return iterations * ((SECONDS_PER_STATIC_STEP if static else SECONDS_PER_STEP) + SECONDS_PER_MEGAPIXEL_STEP * megapixels * area)


def node_training_seconds(facts: Mapping[str, Any], iterations: int) -> float:
    """Seconds that ``iterations`` steps with control nodes take on two cores."""
    return iterations * (SECONDS_PER_NODE_STEP + SECONDS_PER_MEGAPIXEL_NODE_STEP * facts.get("width", 0) * facts.get("height", 0) / 1e6)
