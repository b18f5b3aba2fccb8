"""The visual hull of masks at one time: seeds on the surface of moving objects that several cameras saw at once."""

from __future__ import annotations

import numpy as np

from ...views import Views
from ..volume import common_volume

REACH = 0.8  # of the cameras' median distance: half the side of the volume that is searched
CELLS = 64  # along a side of the volume in the first pass
FINER = 4  # cells of the second pass along a side of a cell of the first
SHARE = 0.85  # of the cameras that see a place must have it on their mask; not all, as masks have holes
LEAST = 3  # cameras that must see a place, or all if there are fewer


def visual_hull(views: Views, masks: list[np.ndarray], frames: np.ndarray, most: int, seed: int) -> np.ndarray:
    """Up to ``most`` points [n, 3] in world units on the surface of the volume on which the masks of ``frames`` agree.

    masks: one [H, W] bool a frame, all of one time. A cell is taken if at least three frames, or both of two, show its centre and at
    least 85 % of these have it on their mask. The searched volume is a cube around the centre of the cameras' common volume that reaches
    most of the way to the cameras.
    """
    centre, _ = common_volume(views)
    radius = REACH * float(np.median(np.linalg.norm(views.centres()[frames] - centre, axis=1)))
    size = 2 * radius / CELLS
    axis = (np.arange(CELLS) + 0.5) * size - radius
    cells = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3) + centre
    # A cell of the first pass may contain a thin part away from its centre, so its masks are grown by half a cell.
    rough = cells[_inside(views, [_grown(m, views, i, centre, size) for m, i in zip(masks, frames)], frames, cells)]
    if not len(rough):
        return np.zeros((0, 3))
    step = (np.arange(FINER) - (FINER - 1) / 2) * size / FINER
    offsets = np.stack(np.meshgrid(step, step, step, indexing="ij"), -1).reshape(-1, 3)
    fine = (rough[:, None] + offsets).reshape(-1, 3)
    fine = fine[_inside(views, masks, frames, fine)]
    fine = fine[_on_surface(fine, centre - radius, size / FINER)]
    rng = np.random.default_rng(seed)
    chosen = rng.permutation(len(fine))[:most]
    return fine[chosen] + rng.uniform(-0.5, 0.5, (len(chosen), 3)) * size / FINER


def _inside(views: Views, masks: list[np.ndarray], frames: np.ndarray, points: np.ndarray) -> np.ndarray:
    hits, seen = np.zeros(len(points), np.int32), np.zeros(len(points), np.int32)
    for mask, i in zip(masks, frames):
        shown, x, y, _ = views.project(int(i), points)
        seen[shown] += 1
        hits[shown] += mask[y, x]
    return (seen >= min(LEAST, len(frames))) & (hits >= SHARE * seen)


def _grown(mask: np.ndarray, views: Views, i: int, centre: np.ndarray, size: float) -> np.ndarray:
    import cv2

    depth = views.cam_from_world[i, 2, :3] @ centre + views.cam_from_world[i, 2, 3]
    pixels = max(1, int(np.ceil(0.9 * size * views.K[i, 0, 0] / max(depth, size))))  # half of a cell's diagonal is 0.87 of its side
    return cv2.dilate(mask.astype(np.uint8), np.ones((2 * pixels + 1, 2 * pixels + 1), np.uint8)) > 0


def _on_surface(points: np.ndarray, corner: np.ndarray, size: float) -> np.ndarray:
    """[n] bool: cells that lack at least one of their six neighbours."""
    cell = np.floor((points - corner) / size).astype(np.int64)
    side = CELLS * FINER + 2
    flat = lambda c: (c[:, 0] * side + c[:, 1]) * side + c[:, 2]  # noqa: E731
    taken = np.unique(flat(cell + 1))
    whole = np.ones(len(points), bool)
    for direction in np.concatenate([np.eye(3, dtype=np.int64), -np.eye(3, dtype=np.int64)]):
        whole &= np.isin(flat(cell + 1 + direction), taken)
    return ~whole
