"""What `coarse` chooses by the capture where the user does not: the motion, the steps, the budget, the seeds. Imports nothing heavy."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...pipeline import Context
from ..artifacts.flow import flow_of
from ..facts import Facts

if TYPE_CHECKING:
    from ...scene.views import Views
    from ..coarse import CoarseSettings

ITERATIONS = 6000
ITERATIONS_A_TIME = 200  # of a rig: each time has its own
MOST_ITERATIONS = 30_000
LEAST_ITERATIONS = 2000  # fewer show fog
ITERATIONS_NODES = 40_000
NODE_TIMES = 9  # fewer say too little about motion


def is_static(ctx: Context) -> bool:
    """Nothing moves: the user says so, or `flow` has found it."""
    flow = flow_of(ctx.inputs)
    return Facts.of(ctx.facts).static or (flow is not None and flow.static)


def auto_budget(facts: Facts, views: Views, nodes: bool) -> int:
    """One Gaussian for eight pixels of one view, 12,000 to 120,000; for five where nodes move them, whose few parameters bear
    more; for four of a rig, which sees a whole room, 40,000 to 240,000."""
    pixels = views.width * views.height
    if facts.rig:
        return int(min(max(pixels // 4, 40_000), 240_000))
    if nodes:
        return int(min(max(pixels // 5, 12_000), 120_000))
    return int(min(max(pixels // 8, 12_000), 120_000))


def auto_seeds(facts: Facts, budget: int) -> int:
    """Half the budget for rigs: what growth adds goes where some primitive is, so each wall needs some to begin with. Else 8000."""
    return budget // 2 if facts.rig else 8000


def auto_sh_degree(facts: Facts) -> int:
    """Few cameras of a rig see a place from few sides, and what they disagree about is not what views between them see."""
    return 1 if facts.rig else 2


def use_nodes(facts: Facts, settings: CoarseSettings) -> bool:
    """Control nodes move the scene where it moves and each frame is a camera of its own: one view a time says too little for planes."""
    if facts.static or settings.motion != "auto":
        return settings.motion == "nodes" and not facts.static
    return facts.cameras == facts.frames and facts.pairs == 0 and facts.times >= NODE_TIMES


def auto_iterations(facts: Facts, settings: CoarseSettings) -> int:
    """6000 steps; for a rig, which is several cameras at one time, at least 200 a time, up to 30,000; `ITERATIONS_NODES` for control nodes;
    all of them times the effort, but never below 2000."""
    steps = ITERATIONS_NODES
    if not use_nodes(facts, settings):
        moving_rig = facts.rig and not facts.static
        steps = min(max(ITERATIONS, ITERATIONS_A_TIME * facts.times if moving_rig else 0), MOST_ITERATIONS)
    return max(round(steps * settings.effort), min(steps, LEAST_ITERATIONS))
