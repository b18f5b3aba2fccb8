"""The four training strategies of Table 3, as the phases that each of the two training stages goes through."""

from __future__ import annotations

from dataclasses import dataclass

from .settings import Strategy

WARM_UP = 0.12  # of the coarse stage: the rest state is learned first, without motion
ALTERNATION = 100  # steps for which one kind is refined while the other waits
HALF_RESOLUTION = 0.5


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


def coarse_phases(strategy: Strategy, iterations: int, static: bool) -> list[Phase]:
    """Gaussians alone: a static warm-up, then deformation. ``joint`` ends after the warm-up, ``progressive`` works at half resolution."""
    scale = HALF_RESOLUTION if strategy == "progressive" else 1.0
    if static:
        return [Phase("static", iterations, move=False, scale=scale)]
    warm_up = round(iterations * WARM_UP)
    phases = [Phase("warm-up", warm_up, move=False, scale=scale)]
    if strategy != "joint":
        phases.append(Phase("deformation", iterations - warm_up, scale=scale))
    return phases


def fine_phases(strategy: Strategy, coarse_iterations: int, iterations: int, static: bool) -> list[Phase]:
    """Gaussians and convexes together; ``joint`` also does here what its coarse stage left out, ``alternating`` lets them take turns."""
    left_over = coarse_iterations - round(coarse_iterations * WARM_UP) if strategy == "joint" and not static else 0
    alternation = ALTERNATION if strategy == "alternating" else 0
    return [Phase("refinement", left_over + iterations, move=not static, alternation=alternation)]
