"""What `flow` and `seeds` measured in the pictures, as training compares renders with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import cv2
import numpy as np
import torch

from ...pipeline import Artifact, Context
from ...scene.losses.held_depth import HeldDepth
from ...scene.losses.measured_depth import MeasuredDepth
from ...scene.losses.term import Measured
from ...scene.views import Views
from ..flow.artifact import StoredFlow
from ..seeds.artifact import read_held
from .frameset import FrameSet
from .masks import moving_mask, unsteady_mask

STATIC_WEIGHT = 0.1  # factor on the weight of measured flow where nothing moves
SHRINK = 4  # factor by which masks of moving pixels are scaled down for training


def load_measured(ctx: Context, frames: FrameSet, views: Views, depth: Mapping[int, np.ndarray], unit: float, moving: bool) -> Measured:
    """All of it, on the device of ``ctx``. depth: the depth maps of `seeds`. unit: the viewing distance, world units. moving: whether
    growth asks for the moving pixels."""
    return Measured(
        measured_flow(ctx.inputs["flow"], views),
        _static_depth(depth, unit, ctx, frames),
        _held_depth(ctx.inputs["seeds"], unit, ctx),
        _moving_pixels(ctx, frames, views) if moving else None,
    )


def measured_flow(flow: Artifact | None, views: Views):
    """``frame -> (flow [h, w, 2] px, weight [h, w] in [0, 1])`` at half resolution, or None if nothing was measured.

    The weight is the flow's confidence, reduced to a tenth where nothing moves. There the flow comes from the cameras alone and teaches
    little (primitives in front of these pixels must not move), yet these many pixels would outweigh the moving ones.
    """
    if flow is None or not (stored := StoredFlow(flow)).measured:
        return None
    pairs = {first: p for p, (first, second) in enumerate(stored.pairs) if int(views.next[first]) == second}
    trained = {int(i) for i in views.train}

    def of_frame(i: int):
        p = pairs.get(int(i))
        if p is None or int(views.next[i]) not in trained:
            return None
        size = views.size(0.5)
        shrink = np.array([size[0] / views.width, size[1] / views.height], np.float32)
        field = cv2.resize(stored.forward(p).astype(np.float32), size, interpolation=cv2.INTER_AREA) * shrink
        weight = cv2.resize(stored.confidence(p), size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255
        if stored.has_moving:
            moves = cv2.resize(stored.moving(int(i)), size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255
            weight = weight * (STATIC_WEIGHT + (1 - STATIC_WEIGHT) * moves)
        kept = views.kept(int(i), 0.5)
        if kept is not None:
            weight = weight * kept.cpu().numpy()
        return torch.from_numpy(np.ascontiguousarray(field)), torch.from_numpy(weight)

    return of_frame


def _held_depth(seeds: Artifact | None, unit: float, ctx: Context) -> HeldDepth | None:
    """The depth maps at which training holds what moves before one camera; None without any."""
    maps = read_held(seeds)
    if not maps:
        return None
    return HeldDepth({frame: torch.from_numpy(one).to(ctx.device) for frame, one in maps.items()}, unit)


def _static_depth(inverse: Mapping[int, np.ndarray], unit: float, ctx: Context, frames: FrameSet) -> MeasuredDepth | None:
    """The depth maps of `seeds` as the target of the depth loss, with scaled-down masks of moving pixels; None without any map."""
    if not inverse:
        return None
    there = {id(one): torch.from_numpy(one).to(ctx.device) for one in inverse.values()}
    maps = {frame: there[id(one)] for frame, one in inverse.items()}
    return MeasuredDepth(maps, unit, _small(lambda i: unsteady_mask(ctx, frames, i), ctx.device))


def _moving_pixels(ctx: Context, frames: FrameSet, views: Views) -> Callable[[int], torch.Tensor | None] | None:
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
