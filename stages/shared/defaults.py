"""What several stages choose for a capture: the budget, and how its steps are scaled. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from ...pipeline import Context
from ...scene.motion.kinds import KINDS
from ..facts import Facts
from ..flow.artifact import flow_of
from ..poses.artifact import found_fixed

if TYPE_CHECKING:
    from ...scene.views import Views

CLIP_PIXELS = 200_000  # of a picture up to which a clip gets all steps on a CPU


def found_facts(ctx: Context, views: Views) -> Facts:
    """Facts about the capture, with what `poses` and `flow` found: whether its only camera stands still, and whether nothing moves. Its
    times are then those of ``views``, one for a moving camera, as with `--static`."""
    facts, flow = Facts.of(ctx.facts), flow_of(ctx.inputs)
    if facts.cameras == 1 and found_fixed(ctx.inputs.get("poses")):
        facts = replace(facts, fixed_cameras=True)
    if flow is None or not flow.static:
        return facts
    return replace(facts, static=True, times=len(set(views.time.tolist())))


def one_way(facts: Facts) -> bool:
    """Whether a moving scene is seen along a path alone: one camera walks past it or stands still, or two or three move together."""
    fixed = facts.fixed_cameras and not facts.stands_still
    return facts.pairs > 0 and not (facts.rig or facts.static or fixed or facts.alpha)


def auto_budget(facts: Facts, views: Views, kind: str) -> int:
    """Most Gaussians at one time: one per four pixels of a view, or as the ``kind`` of motion says, between 12,000 and 120,000. For a rig,
    which sees a whole room, one per four, between 40,000 and 240,000. Along a path three per eight pixels, up to 160,000: most of them are
    at rest, and so present at each time."""
    pixels, each = views.width * views.height, KINDS[kind].pixels
    if facts.rig:
        return int(min(max(pixels // 4, 40_000), 240_000))
    if one_way(facts) and each is None:
        return int(min(max(3 * pixels // 8, 12_000), 160_000))
    return int(min(max(pixels // (each or 4), 12_000), 120_000))


def share_of_steps(facts: Facts, device: str) -> float:
    """By what the steps for one moving camera are multiplied: on a CPU a step costs as much as it has pixels, so larger pictures than
    `CLIP_PIXELS` get fewer, and a phone's clip takes no hours. More steps fit a clip's own path better, not what is seen beside it
    (benchmarks/results/trials.md)."""
    clip = facts.cameras == 1 and facts.pairs > 0 and not facts.static
    return min(1.0, CLIP_PIXELS / (facts.width * facts.height)) if clip and device == "cpu" else 1.0
