"""The depth maps of `seeds` at which training holds what moves before one camera."""

from __future__ import annotations

import torch

from ...pipeline import Artifact, Context
from ...scene.losses.held_depth import HeldDepth
from ..seeds.artifact import read_held


def held_depth(seeds: Artifact | None, unit: float, ctx: Context) -> HeldDepth | None:
    """The maps of ``seeds`` as the target of the loss; None without any. unit: the viewing distance, world units."""
    maps = read_held(seeds)
    if not maps:
        return None
    return HeldDepth({frame: torch.from_numpy(one).to(ctx.device) for frame, one in maps.items()}, unit)
