"""The time that a run was given, and how much of it is left."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from .words import seconds_of, words_for

KEPT_BACK = 0.02  # of the time: late is worse than early


@dataclass
class Deadline:
    """seconds: that the run may take. began: by `time.monotonic`."""

    seconds: float
    began: float = field(default_factory=time.monotonic)

    @classmethod
    def of(cls, text: str, began: float | None = None) -> Deadline:
        return cls(seconds_of(text), time.monotonic() if began is None else began)

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
