"""The settings of a training as one number: its effort. The presets are points of this ladder, and times fall between them.

Below `fast` fewer steps are left of it; between two presets, their settings are interpolated; above `best` nothing is added.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..presets import PRESETS

LEAST_STEPS = 1000  # of the shortest sensible training; with fewer, little more than the seeds is seen
LEAST_EFFORT = 0.05
LEAST_REFINEMENT = 100  # steps of `fine`; with fewer, new convexes stay what they were placed as
REFINEMENT = 1500  # steps of `fine` by default

# The names of the settings that a time decides.
STEPS, SHARE, REFINING = "coarse.iterations", "hulls.share", "fine.iterations"
SIZE, FRAMES, MEASURED, MOVIES = "frames.max_size", "frames.max_frames", "evaluate.measured", "evaluate.movie_frames"
_EFFORT, _FINE_EFFORT, _SHARE_BY_DEFAULT = "coarse.effort", "fine.effort", 0.2


@dataclass(frozen=True)
class Rung:
    """A point of the ladder. steps: of `coarse`. refinement: steps of `fine`. share: largest share of Gaussians that become convexes."""

    effort: float
    steps: int
    refinement: int
    share: float


def rung(effort: float, steps_at_one: int) -> Rung:
    """The rung of ``effort``, where ``steps_at_one`` is the number of coarse steps that is chosen for the capture by default."""
    fast, best = PRESETS["fast"], PRESETS["best"]
    low, high = float(fast[_EFFORT]), float(best[_EFFORT])
    effort = min(max(effort, least_effort(steps_at_one)), high)
    least, most = REFINEMENT * float(fast[_FINE_EFFORT]), REFINEMENT * float(best.get(_FINE_EFFORT, 1.0))
    few, many = float(fast[SHARE]), float(best.get(SHARE, _SHARE_BY_DEFAULT))
    place = min(max((effort - low) / (1.0 - low), 0.0), 1.0)  # 0 at `fast`, 1 at the default preset
    refinement = least + place * (most - least) if effort >= low else least * effort / low
    steps = round(effort * steps_at_one)
    return Rung(effort, steps, max(round(refinement), LEAST_REFINEMENT), round(few + place * (many - few), 3))


def least_effort(steps_at_one: int) -> float:
    """The effort of the shortest sensible training."""
    return min(1.0, max(LEAST_EFFORT, LEAST_STEPS / max(steps_at_one, 1)))


def most_effort() -> float:
    """The effort beyond which more steps bring nothing."""
    return float(PRESETS["best"][_EFFORT])
