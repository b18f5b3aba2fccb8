"""The phases of a training, and the four strategies of Table 3 as such."""

from __future__ import annotations

from dataclasses import dataclass

from ..settings import Strategy

WARM_UP = 0.1  # of the coarse stage: the rest state is learned first, without motion
ALTERNATION = 100  # steps for which one kind is refined while the other is frozen
HALF_RESOLUTION = 0.5
QUARTER_RESOLUTION = 0.25


@dataclass(frozen=True)
class Phase:
    """A run of steps with the same rules.

    name: for people to read. iterations: number of steps. move: whether the motion takes part. scale: image size as a fraction of the full
    size. alternation: number of steps after which Gaussians and convexes take turns; 0 trains both at once.
    """

    name: str
    iterations: int
    move: bool = True
    scale: float = 1.0
    alternation: int = 0


def coarse_phases(strategy: Strategy, iterations: int, static: bool, full_from: float = 0.0, from_rest: bool = True) -> list[Phase]:
    """Gaussians alone: a static warm-up, then deformation. Images have half size up to the fraction ``full_from`` of the steps and full
    size after it; ``progressive`` goes from a quarter to a half instead and leaves full size to `fine`. ``joint`` ends after the warm-up.
    Without ``from_rest`` there is no rest state to learn first, and hence no warm-up.
    """
    first, last = (QUARTER_RESOLUTION, HALF_RESOLUTION) if strategy == "progressive" else (HALF_RESOLUTION, 1.0)
    change = round(iterations * (0.5 if strategy == "progressive" else full_from))
    if static:
        return _split("static", False, 0, iterations, change, first, last)
    warm_up = round(iterations * WARM_UP) if from_rest or strategy == "joint" else 0
    phases = _split("warm-up", False, 0, warm_up, change, first, last)
    if strategy != "joint":
        phases += _split("deformation", True, warm_up, iterations, change, first, last)
    return phases


def _split(name: str, move: bool, start: int, end: int, change: int, first: float, last: float) -> list[Phase]:
    """Steps ``start`` to ``end``, at image scale ``first`` before step ``change`` and ``last`` from there on."""
    change = min(max(change, start), end)
    halves = [Phase(name, change - start, move, first), Phase(name, end - change, move, last)]
    return [phase for phase in halves if phase.iterations]


def left_to_fine(strategy: Strategy, coarse_iterations: int, static: bool) -> int:
    """How many steps of the coarse stage ``joint`` leaves to the fine one: all after the warm-up."""
    return coarse_iterations - round(coarse_iterations * WARM_UP) if strategy == "joint" and not static else 0


def fine_phases(strategy: Strategy, coarse_iterations: int, iterations: int, static: bool) -> list[Phase]:
    """Gaussians and convexes together. ``joint`` adds the steps that its coarse stage left out; ``alternating`` trains them in turns."""
    left_over = left_to_fine(strategy, coarse_iterations, static)
    alternation = ALTERNATION if strategy == "alternating" else 0
    return [Phase("refinement", left_over + iterations, move=not static, alternation=alternation)]


def alike_since(phases: list[Phase], step: int) -> int:
    """The first step from which, up to ``step``, all phases have the same scale and ``move``. Losses before it are not comparable."""
    start = since = 0
    for before, phase in zip([None, *phases], phases):
        if before is not None and (before.scale, before.move) != (phase.scale, phase.move):
            since = start
        start += phase.iterations
        if step <= start:
            break
    return since
