"""What `coarse` chooses automatically for a capture: motion, steps, budget, seeds and SH degree. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from ...pipeline import Context
from ...scene.motion.kinds import KINDS
from ..artifacts.flow import flow_of
from ..facts import Facts

if TYPE_CHECKING:
    from ...scene.views import Views
    from ..coarse import CoarseSettings
    from ..fine import FineSettings

ITERATIONS = 6000
ITERATIONS_A_TIME = 280  # steps per time of a rig, since each time needs its own
MOST_ITERATIONS = 30_000
LEAST_ITERATIONS = 2000  # with fewer, renders look foggy
ITERATIONS_FINE = 1500
LEAST_FINE = 300
CLIP_PIXELS = 250_000  # of a picture up to which a clip gets all steps on a CPU
CONVEXES = 8000
SEEDS, MOST_SEEDS = 8000, 40_000
WIDE_PATH = 60.0  # degrees


def found_facts(ctx: Context, views: Views) -> Facts:
    """Facts about the capture, with what `flow` found. If nothing moves, its times are those of ``views``, one for a moving camera, as with
    `--static`."""
    facts, flow = Facts.of(ctx.facts), flow_of(ctx.inputs)
    if flow is None or not flow.static:
        return facts
    return replace(facts, static=True, times=len(set(views.time.tolist())))


def one_way(facts: Facts) -> bool:
    """Whether a moving scene is seen along a path alone: one camera walks past it, or two or three that move together."""
    return facts.pairs > 0 and not (facts.rig or facts.static or facts.fixed_cameras or facts.alpha)


def auto_budget(facts: Facts, views: Views, kind: str) -> int:
    """Most Gaussians at one time: one per four pixels of a view, or as the ``kind`` of motion says, between 12,000 and 120,000. For a rig,
    which sees a whole room, one per four, between 40,000 and 240,000. Along a path three per eight pixels, up to 160,000: most of them are
    at rest, and so present at each time."""
    pixels = views.width * views.height
    if facts.rig:
        return int(min(max(pixels // 4, 40_000), 240_000))
    pixels_each = KINDS[kind].pixels
    if one_way(facts) and pixels_each is None:
        return int(min(max(3 * pixels // 8, 12_000), 160_000))
    return int(min(max(pixels // (pixels_each or 4), 12_000), 120_000))


def auto_seeds(facts: Facts, budget: int) -> int:
    """Half the budget for rigs: growth adds primitives only near existing ones, so every wall needs some from the start. Also half along
    a path, between 8000 and 40,000. Else 8000."""
    if facts.rig:
        return budget // 2
    return min(max(budget // 2, SEEDS), MOST_SEEDS) if one_way(facts) else SEEDS


def auto_sh_degree(facts: Facts, width: float) -> int:
    """1 for rigs, and along a path of which a point sees less than `WIDE_PATH` (``width``, degrees), else 2. Who sees each point from few
    directions fits its colour to their differences, which does not hold for other views."""
    return 1 if facts.rig or (one_way(facts) and width < WIDE_PATH) else 2


def auto_iterations(facts: Facts, settings: CoarseSettings, kind: str, device: str = "cpu") -> int:
    """6000 steps, fewer for large clips on a CPU (`share_of_steps`); for a rig (several cameras at each time) at least 280 per time, up to
    30,000; or as many as the ``kind`` of motion says. The number is multiplied by the effort, but never below 2000."""
    steps = KINDS[kind].steps
    if steps is None:
        moving_rig = facts.rig and not facts.static
        steps = min(max(ITERATIONS, ITERATIONS_A_TIME * facts.times if moving_rig else 0), MOST_ITERATIONS)
        steps = max(round(steps * share_of_steps(facts, device)), LEAST_ITERATIONS)
    return max(round(steps * settings.effort), min(steps, LEAST_ITERATIONS))


def fine_iterations(settings: FineSettings, facts: Facts | None = None, device: str = "cpu") -> int:
    """Steps of `fine` where it has something to refine; fewer for large clips on a CPU, but not below those of `--preset fast`."""
    if settings.iterations is not None:
        return settings.iterations
    share = 1.0 if facts is None else share_of_steps(facts, device)
    steps = ITERATIONS_FINE * settings.effort
    return round(max(steps * share, min(steps, LEAST_FINE)))


def share_of_steps(facts: Facts, device: str) -> float:
    """By what the steps for one moving camera are multiplied: on a CPU a step costs as much as it has pixels, so larger pictures than
    `CLIP_PIXELS` get fewer, and a phone's clip takes no hours. More steps fit a clip's own path better, not what is seen beside it
    (docs/trials.md)."""
    clip = facts.cameras == 1 and facts.pairs > 0 and not facts.static
    return min(1.0, CLIP_PIXELS / (facts.width * facts.height)) if clip and device == "cpu" else 1.0


def most_convexes(budget: int | None, kind: str) -> int:
    """The largest number of convexes: ``budget``, or `CONVEXES` if it is None, but none with a ``kind`` of motion with which they gain
    nothing."""
    if budget is not None:
        return budget
    return CONVEXES if KINDS[kind].convexes else 0
