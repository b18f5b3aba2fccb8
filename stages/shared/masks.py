"""Which pixels of a frame move or do not count, by the capture's own masks or by `flow`; for training, scaled down."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import cv2
import numpy as np
import torch

from ...pipeline import Context
from ...scene.losses.measured_depth import MeasuredDepth
from ...scene.views import Views
from ..flow.artifact import flow_of
from .frameset import FrameSet

SHRINK = 4  # factor by which masks of moving pixels are scaled down for the depth loss


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


def measured_depth(inverse: Mapping[int, np.ndarray], unit: float, ctx: Context, frames: FrameSet) -> MeasuredDepth | None:
    """The depth maps of `seeds` as the target of the depth loss, with scaled-down masks of moving pixels; None without any map."""
    if not inverse:
        return None
    there = {id(one): torch.from_numpy(one).to(ctx.device) for one in inverse.values()}
    maps = {frame: there[id(one)] for frame, one in inverse.items()}
    return MeasuredDepth(maps, unit, _small(lambda i: unsteady_mask(ctx, frames, i), ctx.device))


def moving_pixels(ctx: Context, frames: FrameSet, views: Views) -> Callable[[int], torch.Tensor | None] | None:
    """`moving_mask` of a frame, scaled down: [h, w] bool on the device of ``ctx``, or None if nothing moves in it. None if no training
    frame has a mask."""
    mask = lambda i: moving_mask(ctx, frames, i)  # noqa: E731
    return _small(mask, ctx.device) if any(mask(int(i)) is not None for i in views.train) else None


def _small(full: Callable[[int], np.ndarray | None], device: str) -> Callable[[int], torch.Tensor | None]:
    """The masks ``full(i)`` scaled down, where any part of a pixel is masked; None if nothing is."""
    known: dict[int, torch.Tensor | None] = {}

    def small(i: int) -> torch.Tensor | None:
        if i not in known:
            mask = full(i)
            if mask is not None:
                height, width = mask.shape
                size = max(1, width // SHRINK), max(1, height // SHRINK)
                part = cv2.resize(mask.astype("float32"), size, interpolation=cv2.INTER_AREA)
                known[i] = torch.from_numpy(part > 0).to(device) if part.any() else None
            else:
                known[i] = None
        return known[i]

    return small
