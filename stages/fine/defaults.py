"""What `fine` chooses for a capture: how many steps it takes, if any. Imports nothing heavy."""

from __future__ import annotations

from ...scene.motion.kinds import KINDS, choose
from ..facts import Facts
from ..shared.defaults import one_way, share_of_steps
from .settings import FineSettings

ITERATIONS = 1500
LEAST_ITERATIONS = 300
LR_SCALE, LR_SCALE_ALONE = 0.3, 0.1  # along a path each time is seen once, so larger rates undo more than so few steps mend


def fine_iterations(settings: FineSettings, facts: Facts | None = None, device: str = "cpu") -> int:
    """Steps of `fine` where it has something to refine; fewer for large clips on a CPU, but not below those of `--preset fast`."""
    if settings.iterations is not None:
        return settings.iterations
    share = 1.0 if facts is None else share_of_steps(facts, device)
    steps = ITERATIONS * settings.effort
    return round(max(steps * share, min(steps, LEAST_ITERATIONS)))


def auto_lr_scale(settings: FineSettings, facts: Facts) -> float:
    """Factor on the first rates of what `coarse` has trained, as set or as is usual for such a capture."""
    if settings.lr_scale is not None:
        return settings.lr_scale
    return LR_SCALE_ALONE if one_way(facts) else LR_SCALE


def rests(facts: Facts, settings: FineSettings) -> bool:
    """Whether there is nothing to do unless `hulls` was told to place convexes."""
    return settings.iterations is None and not KINDS[choose(None, facts)].convexes
