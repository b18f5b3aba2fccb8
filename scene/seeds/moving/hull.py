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
MOST_KEPT = 64  # cameras whose view of the cells is kept, 1 MB each


class VisualHull:
    """Of ``views``, at any of their times. Cameras that stand still see the cells of the first pass alike at all times, so that is kept."""

    def __init__(self, views: Views) -> None:
        self._views, (self._centre, _) = views, common_volume(views)
        self._kept: dict[tuple[bytes, bytes, float], np.ndarray] = {}

    def points(self, masks: list[np.ndarray], frames: np.ndarray, most: int, seed: int) -> np.ndarray:
        """Up to ``most`` points [n, 3] in world units on the surface of the volume on which the masks of ``frames`` agree.

        masks: one [H, W] bool a frame, all of one time. A cell is taken if at least three frames, or both of two, show its centre and at
        least 85 % of these have it on their mask. The searched volume is a cube around the centre of the cameras' common volume that
        reaches most of the way to the cameras. May be called by several threads at once.
        """
        views, centre = self._views, self._centre
        radius = REACH * float(np.median(np.linalg.norm(views.centres()[frames] - centre, axis=1)))
        size, cells = 2 * radius / CELLS, _cells(centre, radius)
        # A cell of the first pass may contain a thin part away from its centre, so its masks are grown by half a cell.
        grown = [_grown(m, views, i, centre, size) for m, i in zip(masks, frames)]
        rough = cells[_agree(grown, [self._pixels_of_cells(int(i), cells, radius) for i in frames])]
        if not len(rough):
            return np.zeros((0, 3))
        step = (np.arange(FINER) - (FINER - 1) / 2) * size / FINER
        offsets = np.stack(np.meshgrid(step, step, step, indexing="ij"), -1).reshape(-1, 3)
        fine = (rough[:, None] + offsets).reshape(-1, 3)
        fine = fine[_agree(masks, [_pixels(views, int(i), fine) for i in frames])]
        fine = fine[_on_surface(fine, centre - radius, size / FINER)]
        rng = np.random.default_rng(seed)
        chosen = rng.permutation(len(fine))[:most]
        return fine[chosen] + rng.uniform(-0.5, 0.5, (len(chosen), 3)) * size / FINER

    def _pixels_of_cells(self, i: int, cells: np.ndarray, radius: float) -> np.ndarray:
        """`_pixels` of the cells of the first pass, which ``radius`` determines."""
        views = self._views
        key = views.K[i].tobytes(), views.cam_from_world[i].tobytes(), radius
        found = self._kept.get(key)
        if found is None:
            found = _pixels(views, i, cells)
            if len(self._kept) < MOST_KEPT:
                self._kept[key] = found
        return found


def _cells(centre: np.ndarray, radius: float) -> np.ndarray:
    """Centres [n, 3] of the cells of the first pass."""
    axis = (np.arange(CELLS) + 0.5) * (2 * radius / CELLS) - radius
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3) + centre


def _agree(masks: list[np.ndarray], pixels: list[np.ndarray]) -> np.ndarray:
    """[n] bool: the points that are inside. pixels: for each mask what `_pixels` returns of these points."""
    hits, seen = np.zeros(len(pixels[0]), np.int32), np.zeros(len(pixels[0]), np.int32)
    for mask, pixel in zip(masks, pixels):
        seen += pixel >= 0
        hits += np.append(mask, False)[pixel]  # the last one for -1
    return (seen >= min(LEAST, len(masks))) & (hits >= SHARE * seen)


def _pixels(views: Views, i: int, points: np.ndarray) -> np.ndarray:
    """[n] int32: the pixel, counted row by row, in which frame ``i`` shows each of ``points`` [n, 3]; -1 if it does not show it."""
    shown, x, y, _ = views.project(i, points)
    found = np.full(len(points), -1, np.int32)
    found[shown] = y * views.width + x
    return found


def _grown(mask: np.ndarray, views: Views, i: int, centre: np.ndarray, size: float) -> np.ndarray:
    import cv2

    depth = views.cam_from_world[i, 2, :3] @ centre + views.cam_from_world[i, 2, 3]
    pixels = max(1, int(np.ceil(0.9 * size * views.K[i, 0, 0] / max(depth, size))))  # half of a cell's diagonal is 0.87 of its side
    return cv2.dilate(mask.astype(np.uint8), np.ones((2 * pixels + 1, 2 * pixels + 1), np.uint8)) > 0


def _on_surface(points: np.ndarray, corner: np.ndarray, size: float) -> np.ndarray:
    """[n] bool: cells that lack at least one of their six neighbours."""
    cell = np.floor((points - corner) / size).astype(np.int64) + 1
    side = CELLS * FINER + 2
    taken = np.zeros(side**3, bool)
    flat = (cell[:, 0] * side + cell[:, 1]) * side + cell[:, 2]
    taken[flat] = True
    whole = np.ones(len(points), bool)
    for offset in (1, side, side * side):
        whole &= taken[flat + offset] & taken[flat - offset]
    return ~whole
