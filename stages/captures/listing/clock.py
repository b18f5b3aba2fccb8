"""Times of one camera's pictures whose files give none: their numbers count, also where structure from motion dropped frames."""

from __future__ import annotations

from collections.abc import Sequence

from ..reading import DEFAULT_FPS, Shot
from .numbers import places


def follow_numbers(shots: Sequence[Shot], fps: float | None) -> tuple[str, ...]:
    """Sets `Shot.time` of ``shots``, in order, by the numbers in the names of their files, and `Shot.seconds` where some are missing.
    fps: of the numbers; `DEFAULT_FPS` if None. Returns a line for people where numbers are missing or say nothing."""
    clock, told = places([shot.file or shot.name for shot in shots])
    for shot, at in zip(shots, clock, strict=True):
        shot.time = float(at)
        if clock[-1] + 1 > len(shots):
            shot.seconds = at / (fps or DEFAULT_FPS)
    return (told,) if told else ()
