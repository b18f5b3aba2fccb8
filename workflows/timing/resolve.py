"""From seconds to settings: the largest training that fits. Pure functions; a longer time never has fewer steps."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from .ladder import LEAST_REFINEMENT, Rung, least_effort, most_effort, rung

RUNGS = 200  # of the ladder that are tried, evenly spread in the logarithm of the effort
FEW_VIEWS = 8  # views of a split that are measured at least
PICTURES = (60, 30, 0)  # of each movie of the report, from which one is chosen


@dataclass(frozen=True)
class Chosen:
    """A training that was chosen. seconds: expected for `coarse`, `hulls` and `fine`. fits: whether these are within the time that there
    is; if not, it is the shortest sensible training. full: whether more time would change nothing."""

    rung: Rung
    coarse: float
    hulls: float
    fine: float
    fits: bool
    full: bool

    @property
    def seconds(self) -> float:
        return self.coarse + self.hulls + self.fine


@dataclass(frozen=True)
class TrainingTimes:
    """Expected seconds of the three stages of training. coarse, fine: of a number of steps; fine is None if that stage has nothing to do.
    hulls: seconds."""

    coarse: Callable[[int], float]
    fine: Callable[[int], float] | None
    hulls: float = 0.0

    def of(self, one: Rung) -> tuple[float, float, float]:
        return self.coarse(one.steps), self.hulls, 0.0 if self.fine is None else self.fine(one.refinement)


def choose(seconds: float, times: TrainingTimes, steps_at_one: int, fixed_steps: int | None = None) -> Chosen:
    """The highest rung whose training takes at most ``seconds``; the lowest one if none does. fixed_steps: of `coarse`, if the user chose
    their number; then only what follows is chosen."""
    low, high = least_effort(steps_at_one), most_effort()
    best: Chosen | None = None
    longest = 0.0  # of the rungs so far: a higher rung may be expected to take a little less than the one below it
    for k in range(RUNGS + 1):
        one = _rung(low * (high / low) ** (k / RUNGS), steps_at_one, fixed_steps)
        coarse, hulls, fine = times.of(one)
        longest = max(longest, coarse + hulls + fine)
        fits = longest <= seconds
        if k == 0 or fits:
            best = Chosen(one, coarse, hulls, fine, fits, k == RUNGS)
    assert best is not None
    return best


def refinement_within(seconds: float, seconds_of: Callable[[int], float], most: int) -> int:
    """The largest number of steps of `fine`, up to ``most``, that take at most ``seconds``, but not below `LEAST_REFINEMENT`. It is a
    multiple of ten, or ``most``."""
    if seconds_of(most) <= seconds:
        return most
    low, high = 0, most // 10  # tens of steps; seconds_of grows with them
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if seconds_of(10 * middle) <= seconds else (low, middle)
    return min(most, max(10 * low, LEAST_REFINEMENT))


@dataclass(frozen=True)
class Judged:
    """What `evaluate` does. measured: most views of a split; None: as many as by default. movies: pictures of a movie; None: as by default.
    seconds: that it is expected to take."""

    measured: int | None
    movies: int | None
    seconds: float


def evaluation_within(seconds: float, seconds_of: Callable[[int, int], float], views: int) -> Judged:
    """The most thorough evaluation that takes at most ``seconds``, or the shortest sensible one. ``views`` of a split are measured by
    default. seconds_of: of a number of views and of pictures in a movie. Views go first, down to a half; then movies; then more views."""
    half = max(FEW_VIEWS, math.ceil(views / 2))
    for movies, least in ((PICTURES[0], half), (PICTURES[1], half), (PICTURES[1], FEW_VIEWS), (PICTURES[2], FEW_VIEWS)):
        for measured in range(views, min(least, views) - 1, -1):
            if seconds_of(measured, movies) <= seconds:
                shown = None if movies == PICTURES[0] else movies
                return Judged(None if measured == views else measured, shown, seconds_of(measured, movies))
    few = min(FEW_VIEWS, views)
    return Judged(few, PICTURES[-1], seconds_of(few, PICTURES[-1]))


def shortest(times: TrainingTimes, steps_at_one: int, fixed_steps: int | None = None) -> float:
    """Seconds of the shortest sensible training; with ``fixed_steps`` of `coarse`, if the user chose their number."""
    return sum(times.of(_rung(least_effort(steps_at_one), steps_at_one, fixed_steps)))


def _rung(effort: float, steps_at_one: int, fixed_steps: int | None) -> Rung:
    one = rung(effort, steps_at_one)
    return one if fixed_steps is None else replace(one, steps=fixed_steps)
