"""The four training strategies of Table 3, as the phases that each of the two training stages goes through."""

from __future__ import annotations

from dataclasses import dataclass

from ..settings import Strategy

WARM_UP = 0.1  # of the coarse stage: the rest state is learned first, without motion
ALTERNATION = 100  # steps for which one kind is refined while the other waits
HALF_RESOLUTION = 0.5
QUARTER_RESOLUTION = 0.25
NODE_WARM_UP, NODE_SMALL = 0.02, 0.1  # of the coarse stage with control nodes: without motion; on small images


@dataclass(frozen=True)
class Phase:
    """A run of steps under one rule.

    name: for people. iterations: steps. move: the deformation field takes part. scale: image size as a fraction of the full one.
    alternation: steps after which the kinds take turns, 0 for both at once.
    """

    name: str
    iterations: int
    move: bool = True
    scale: float = 1.0
    alternation: int = 0


def coarse_phases(strategy: Strategy, iterations: int, static: bool, full_from: float = 0.0, from_rest: bool = True) -> list[Phase]:
    """Gaussians alone: a static warm-up, then deformation. Images have half their size up to the fraction ``full_from`` of the steps, then
    their full size; ``progressive`` goes from a quarter to a half instead and leaves the full size to `fine`. ``joint`` ends after the
    warm-up. Without ``from_rest`` there is no state of rest to begin with, and no warm-up.
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
    """Steps ``start`` to ``end``, at the size ``first`` before step ``change`` and ``last`` from there on."""
    change = min(max(change, start), end)
    halves = [Phase(name, change - start, move, first), Phase(name, end - change, move, last)]
    return [phase for phase in halves if phase.iterations]


def node_phases(iterations: int, scale: float) -> list[Phase]:
    """For control nodes: a short static warm-up and the first motion on images of ``scale``, then images of full size."""
    warm_up, small = round(iterations * NODE_WARM_UP), round(iterations * NODE_SMALL)
    phases = [Phase("warm-up", warm_up, False, scale), Phase("deformation", small - warm_up, True, scale)]
    phases.append(Phase("deformation", iterations - small, True))
    return [phase for phase in phases if phase.iterations > 0]


def fine_phases(strategy: Strategy, coarse_iterations: int, iterations: int, static: bool) -> list[Phase]:
    """Gaussians and convexes together; ``joint`` also does here what its coarse stage left out, ``alternating`` lets them take turns."""
    left_over = coarse_iterations - round(coarse_iterations * WARM_UP) if strategy == "joint" and not static else 0
    alternation = ALTERNATION if strategy == "alternating" else 0
    return [Phase("refinement", left_over + iterations, move=not static, alternation=alternation)]


def alike_since(phases: list[Phase], step: int) -> int:
    """The step from which on, up to ``step``, all phases are of one image size and one rule: losses of before do not compare."""
    start = since = 0
    for before, phase in zip([None, *phases], phases):
        if before is not None and (before.scale, before.move) != (phase.scale, phase.move):
            since = start
        start += phase.iterations
        if step <= start:
            break
    return since
