"""Which pixels of a frame move or do not count, by the capture's own masks or by `flow`."""

from __future__ import annotations

import numpy as np

from ...pipeline import Context
from ..flow.artifact import flow_of
from .frameset import FrameSet


def moving_mask(ctx: Context, frames: FrameSet, i: int) -> np.ndarray | None:
    """[H, W] bool, moving pixels of frame ``i`` by the capture's own mask, otherwise by `flow`; None if there is neither."""
    mask = frames.mask(i)
    flow = flow_of(ctx.inputs)
    if mask is None and flow is not None and flow.has_moving:
        mask = flow.moving(i)
    if mask is None:
        return None
    kept = frames.kept(i)
    return mask > 127 if kept is None else (mask > 127) & kept


def unsteady_mask(ctx: Context, frames: FrameSet, i: int) -> np.ndarray | None:
    """[H, W] bool, pixels of frame ``i`` that do not show the static scene: they are moving or do not count; None without any mask."""
    moving, kept = moving_mask(ctx, frames, i), frames.kept(i)
    if kept is None:
        return moving
    return ~kept if moving is None else moving | ~kept
