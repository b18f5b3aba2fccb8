"""Presets: named sets of settings. ``--set`` wins over a preset."""

from collections.abc import Mapping
from typing import Any

PRESETS: Mapping[str, Mapping[str, Any]] = {
    "default": {},
    # A first look within minutes on two cores.
    "fast": {
        "coarse.iterations": 1200,
        "hulls.budget": 1000,
        "fine.iterations": 300,
    },
}
