"""Presets: named sets of settings. ``--set`` wins over a preset."""

from collections.abc import Mapping
from typing import Any

PRESETS: Mapping[str, Mapping[str, Any]] = {
    "default": {},
    # A first look within minutes on two cores.
    "fast": {"coarse.effort": 0.15, "hulls.share": 0.04, "fine.effort": 0.2},
    # A small file that plays fast anywhere: at most 5000 Gaussians and convexes in all, a fifth of them convexes at edges.
    "compact": {"train.budget": 5000, "hulls.budget": 1000},
    # As good as it gets, for as long as it takes.
    "best": {"coarse.effort": 3.0},
}
