"""Seeds of the static scene before one camera that stands still: the background once, at the capture's depth or at an assumed one."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np

from ...pipeline import Context
from ...scene.seeds.one_place import LOOKS, assumed_depth, background
from ...scene.seeds.rays import spread
from ...scene.views import Views
from ...vision.images.pictures import size_within
from ..depth.artifact import StoredDepth, read_depth
from ..shared.frameset import FrameSet
from ..shared.masks import unsteady_mask

MAP = 320  # px, longest side of the map of inverse depth
OPAQUE = 127  # of 255, alpha above which a pixel shows something


class Standing(NamedTuple):
    """points [N, 3] world units, colors [N, 3] in [0, 1]. inverse: see `Swept`. given: depth that came with the capture."""

    points: np.ndarray
    colors: np.ndarray
    inverse: dict[int, np.ndarray]
    given: StoredDepth | None


def standing_seeds(ctx: Context, frames: FrameSet, views: Views, count: int) -> Standing:
    """About ``count`` seeds, evenly spread over the picture."""

    def unsteady(i: int) -> np.ndarray | None:
        return unsteady_mask(ctx, frames, i)

    plate, i = background(views, unsteady), int(views.train[0])
    depth, given = assumed_depth(views.K[i], views.width, views.height), read_depth(ctx.inputs.get("depth"))
    if given is None:
        ctx.log(
            "seeds: how far away the background is, is assumed: a level floor below the horizon, and a wall behind it; depth/ beside "
            "images/ tells it"
        )
    else:
        depth = _with_given(given, depth, unsteady)
    at = spread(views.width, views.height, count, np.random.default_rng(ctx.settings.seed))
    column, row = at.astype(int).T
    if frames.alpha:
        opaque = np.max([frames.image(int(k))[..., 3] for k in views.train[:: max(1, len(views.train) // LOOKS)]], axis=0) > OPAQUE
        at, column, row = (one[opaque[row, column]] for one in (at, column, row))
    points = views.lift(i, at, depth[row, column]).astype(np.float32).astype(np.float64)
    ctx.log(f"seeds: {len(points)} on the background, which is the median of its pictures")
    size = size_within(views.width, views.height, MAP)
    inverse = cv2.resize((1 / depth).astype(np.float32), size, interpolation=cv2.INTER_NEAREST)
    return Standing(points, plate[row, column] / 255.0, dict.fromkeys(views.train.tolist(), inverse), given)


def _with_given(given: StoredDepth, assumed: np.ndarray, unsteady: Callable[[int], np.ndarray | None]) -> np.ndarray:
    """Depth [H, W] of the background: the median over time of what is given of it, and where nothing is, the nearest that is."""
    seen = []
    for i, z in given.z.items():
        moves = unsteady(i)
        there = (z > 0) & (given.confidence[i] > 0)
        if moves is not None:
            there &= cv2.resize(moves.astype(np.uint8), z.shape[::-1], interpolation=cv2.INTER_NEAREST) == 0
        seen.append(np.where(there, z, np.nan))
    stack = np.stack(seen)
    known = np.isfinite(stack).any(axis=0)
    if not known.any():
        return assumed
    depth = np.zeros(known.shape, np.float32)
    depth[known] = np.nanmedian(stack[:, known], axis=0)
    _, nearest = cv2.distanceTransformWithLabels((~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    of_label = np.zeros(nearest.max() + 1, np.float32)
    of_label[nearest[known]] = depth[known]
    return np.asarray(cv2.resize(of_label[nearest], assumed.shape[::-1], interpolation=cv2.INTER_NEAREST))
