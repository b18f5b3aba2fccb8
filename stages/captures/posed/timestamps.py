"""Times of frames that a file of cameras gives as `timestamp`, as recorders do, and not as `time`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median
from typing import Any

_KEY = "timestamp"
_LONGEST = 10.0  # s between two frames, below which the numbers count as seconds
_MOST = 10**19  # ns since 1970 are 2e18
_SHORTEST = 1_000_000  # ns between two frames, from which on whole numbers count as nanoseconds


@dataclass(frozen=True)
class Stamps:
    """since: of every frame since the first one, in the file's own unit; None if they are not read. unit: seconds, None if it is unknown.
    note: what was done, for people; None without any."""

    since: list[float] | None = None
    unit: float | None = None
    note: str | None = None


def timestamps(frames: Sequence[Mapping[str, Any]], file: str, timed: bool) -> Stamps:
    """timed: the frames have a `time`, which is read in place of this."""
    found = [frame.get(_KEY) for frame in frames]
    given = [value for value in found if value is not None]
    if not given:
        return Stamps()
    if timed:
        return Stamps(note=f"{file}: {_KEY} of the frames is not read, because they have a time as well")
    numbers = [value for value in given if _is_time(value)]
    if len(numbers) < len(found):
        i = next(i for i, value in enumerate(found) if not _is_time(value))
        what = "has none" if found[i] is None else f"has {str(found[i])[:40]!r}, no number"
        return Stamps(note=f"{file}: {_KEY} of the frames is not read, because frame {i} {what}; frames are in the order of their names")
    if len(set(numbers)) < 2:
        return Stamps(note=f"{file}: {_KEY} of the frames is not read, because all are equal; frames are in the order of their names")
    first = min(numbers)
    since = [float(number - first) for number in numbers]  # whole nanoseconds since 1970 have too many digits for a float
    ordered = sorted(set(since))
    gap = median(b - a for a, b in pairwise(ordered))
    whole = all(isinstance(number, int) for number in numbers)
    unit = 1e-9 if whole and gap >= _SHORTEST else 1.0 if gap <= _LONGEST else None
    name = {1e-9: "nanoseconds", 1.0: "seconds", None: "an unknown unit, so how fast they pass is not known"}[unit]
    return Stamps(since, unit, f"{file}: the frames have no time; their {_KEY} is read, in {name}")


def _is_time(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and -_MOST <= value <= _MOST  # NaN is not
