"""The recipe of control nodes, and the phases of their training. Imports nothing heavy: the plan counts their steps."""

from __future__ import annotations

from dataclasses import replace

from ...settings import Strategy
from ..phases import HALF_RESOLUTION, QUARTER_RESOLUTION, Phase
from ..recipe import FirstTraining, Recipe

BY_NODE_PHASES = ("two-stage", "alternating")  # strategies in which control nodes have a schedule of their own
FIRST_MOTION_STEPS, FIRST_MOTION_SHARE = 4000, 2 / 3  # most steps of the first training of nodes; and as a share of those that follow
FIRST_GAUSSIANS = 5000  # of the first training: half of the pixels of a 400x400 image at a quarter of its size
WARM_UP, SMALL = 0.02, 0.1  # fractions of the coarse stage: without motion; on small images

NODES = Recipe(
    freeze_at=0.6,
    freeze_share=0.25,
    spread_at=(0.1, 0.25),
    rigid_parts_at=(0.1, 0.2, 0.3),
    grow_until=0.8,
    rounds=150,
    opacity=0.01,
    rest=0.0,
    inertia=0.03,
    interval=0.0,
    spread=0.3,
    steady=True,
    largest_convex=0.03,
    prune_at=0.85,
    hidden_at=(0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8),
)
# Nodes that only look for the motion: what is found here is moved and refined later, so nothing turns rigid or is hidden yet.
FIRST_MOTION = replace(NODES, rigid_parts_at=(), spread_at=(0.5,), hidden_at=(), prune_at=0.9)


def first_motion_steps(strategy: Strategy, iterations: int) -> int:
    """How many steps on very small images precede ``iterations`` steps of the coarse stage."""
    return min(FIRST_MOTION_STEPS, round(FIRST_MOTION_SHARE * iterations)) if strategy in BY_NODE_PHASES else 0


def first_motion(strategy: Strategy, iterations: int, small: bool) -> FirstTraining | None:
    """A first, short training on images of a quarter of the size, or of half the size if they are ``small`` anyway, in which nodes find
    the motion before anything has detail.

    Nodes that start on detailed images settle where a limb is folded or swapped with another. No gradient leads out of there, and the
    prior towards rigid parts holds them in it, so it is off here.
    """
    if strategy not in BY_NODE_PHASES:
        return None
    steps = first_motion_steps(strategy, iterations)
    scale = HALF_RESOLUTION if small else QUARTER_RESOLUTION
    warm_up = round(steps * WARM_UP)
    phases = [Phase("shape", warm_up, False, scale), Phase("motion", steps - warm_up, True, scale)]
    return FirstTraining(
        "first motion", [phase for phase in phases if phase.iterations > 0], FIRST_MOTION, FIRST_GAUSSIANS, {"rigid_weight": 0.0}
    )


def node_phases(iterations: int, scale: float) -> list[Phase]:
    """Phases for control nodes: a short static warm-up and some motion on images of ``scale``, then full-size images."""
    warm_up, small = round(iterations * WARM_UP), round(iterations * SMALL)
    phases = [Phase("warm-up", warm_up, False, scale), Phase("deformation", small - warm_up, True, scale)]
    phases.append(Phase("deformation", iterations - small, True))
    return [phase for phase in phases if phase.iterations > 0]
