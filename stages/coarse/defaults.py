"""What `coarse` chooses for a capture: steps and SH degree. Imports nothing heavy."""

from __future__ import annotations

from ...scene.motion.kinds import KINDS, choose
from ..facts import Facts
from ..shared.defaults import one_way, share_of_steps
from .settings import CoarseSettings

ITERATIONS = 6000
ITERATIONS_A_TIME = 280  # steps per time of a rig, since each time needs its own
MOST_ITERATIONS = 30_000
LEAST_ITERATIONS = 2000  # with fewer, renders look foggy
ITERATIONS_A_VIEW, ENOUGH = 400, 20_000  # of a motion with a number of steps of its own: few views teach all they can in fewer
WIDE_PATH = 60.0  # degrees


def auto_iterations(facts: Facts, settings: CoarseSettings, device: str = "cpu") -> int:
    """6000 steps, fewer for large clips on a CPU (`share_of_steps`); for a rig (several cameras at each time) at least 280 per time, up to
    30,000; or as many as the kind of motion asks for. The number is multiplied by the effort, but never below 2000.

    A motion that asks for a number gets at most 400 steps for each training view, or 20,000 (benchmarks/results/trials.md); of these, too,
    an effort above 1 is a multiple."""
    steps = KINDS[choose(settings.motion, facts)].steps
    if steps is not None:
        most = max(ITERATIONS_A_VIEW * facts.splits.get("train", steps), ENOUGH)
        return max(round(min(steps * settings.effort, most * max(settings.effort, 1.0))), LEAST_ITERATIONS)
    moving_rig = facts.rig and not facts.static
    steps = min(max(ITERATIONS, ITERATIONS_A_TIME * facts.times if moving_rig else 0), MOST_ITERATIONS)
    steps = max(round(steps * share_of_steps(facts, device)), LEAST_ITERATIONS)
    return max(round(steps * settings.effort), min(steps, LEAST_ITERATIONS))


def auto_sh_degree(facts: Facts, width: float) -> int:
    """0 for a camera that stands still. 1 for rigs, and along a path of which a point sees less than `WIDE_PATH` (``width``, degrees), else
    2. Who sees each point from few directions fits its colour to their differences, which does not hold for other views."""
    if facts.stands_still:
        return 0
    return 1 if facts.rig or (one_way(facts) and width < WIDE_PATH) else 2
