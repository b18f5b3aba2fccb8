"""Times as people write them on a command line: 90s, 10m, 1h30m."""

from __future__ import annotations

import re

from ...pipeline import SettingsError

MOST = 1000 * 3600.0
_NUMBER = r"(\d+(?:\.\d+)?)"
_FORM = re.compile(rf"(?:{_NUMBER}h)?(?:{_NUMBER}m(?:in)?)?(?:{_NUMBER}s)?", re.ASCII)


def seconds_of(text: str) -> float:
    """``"1h30m"`` -> 5400. Raises SettingsError."""
    found = _FORM.fullmatch(text.strip().lower())
    if found is None or not any(found.groups()):
        raise SettingsError(f"--time {text}: expected a time such as 90s, 10m, 1h or 1h30m")
    hours, minutes, rest = (float(part or 0) for part in found.groups())
    seconds = 3600 * hours + 60 * minutes + rest
    if not 1 <= seconds <= MOST:
        raise SettingsError(f"--time {text}: expected at least 1s and at most {MOST / 3600:.0f}h")
    return seconds


def words_for(seconds: float) -> str:
    """The shortest way to write a time, to the nearest second: ``5400`` -> ``"1h30m"``. Equal times have equal words."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    parts = [f"{count}{unit}" for count, unit in ((hours, "h"), (minutes, "m"), (rest, "s")) if count]
    return "".join(parts) or "0s"
