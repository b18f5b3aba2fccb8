"""Sizes and ages as people type them: 10G, 500M, 30d, 12h."""

from __future__ import annotations

import re
from datetime import UTC, datetime

from ...pipeline import SettingsError

_BYTES = {"": 1, "K": 1e3, "M": 1e6, "G": 1e9, "T": 1e12}
_SECONDS = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0, "w": 604800.0}


def bytes_of(option: str, text: str) -> int:
    """``10G`` -> 10**10. Raises SettingsError that names the option."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([KMGT]?)B?", text.strip(), re.IGNORECASE)
    if found is None:
        raise SettingsError(f"{option} {text}: give a number of bytes, as in 500M, 10G or 1.5T")
    return round(float(found[1]) * _BYTES[found[2].upper()])


def seconds_of(option: str, text: str) -> float:
    """``30d`` -> 2592000.0. Raises SettingsError that names the option."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([smhdw])", text.strip())
    if found is None:
        raise SettingsError(f"{option} {text}: give an age, as in 12h, 30d or 8w (s, m for minutes, h, d, w)")
    return float(found[1]) * _SECONDS[found[2]]


def megabytes(size: int) -> str:
    """``12.3 MB``; from 1000 MB on, ``1.23 GB``."""
    return f"{size / 1e6:.1f} MB" if size < 1e9 else f"{size / 1e9:.2f} GB"


def age(made: str, now: datetime | None = None) -> str:
    """How long ago ``made``, a date as provenance has it, was: ``40 s``, ``12 min``, ``5 h``, ``3 d``; "" if it is no date."""
    try:
        then = datetime.fromisoformat(made)
    except ValueError:
        return ""
    then = then.replace(tzinfo=UTC) if then.tzinfo is None else then
    seconds = max(0.0, ((now or datetime.now(UTC)) - then).total_seconds())
    for unit, name in ((86400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= unit:
            return f"{seconds / unit:.0f} {name}"
    return f"{seconds:.0f} s"
