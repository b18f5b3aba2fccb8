"""The time that a run was given, as people write it (90s, 10m, 1h30m), and how much of it is left."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass, field

from ...pipeline import SettingsError

KEPT_BACK = 0.02  # of the time: late is worse than early
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


@dataclass
class Deadline:
    """seconds: that the run may take. began: by `time.monotonic`."""

    seconds: float
    began: float = field(default_factory=time.monotonic)

    @property
    def words(self) -> str:
        return words_for(self.seconds)

    @property
    def spent(self) -> float:
        return time.monotonic() - self.began

    @property
    def left(self) -> float:
        """Seconds to plan with."""
        return (1 - KEPT_BACK) * self.seconds - self.spent
