"""Learning rates over the course of a training."""

from __future__ import annotations

from collections.abc import Callable

Rate = Callable[[float], float]
APPEARANCE_END = 0.3  # of the first rate: means and motion have to settle, appearance goes on learning


def exponential(first: float, last: float) -> Rate:
    """A rate that decays exponentially from ``first`` to ``last``, as a function of progress in [0, 1]."""
    return lambda progress: first * (last / first) ** min(max(progress, 0.0), 1.0)
