"""Scene flow from several synchronised cameras: moves points on moving objects to the next time using the flow of all cameras.

A point seen by some cameras moves to where the rays through its pixels, displaced by flow, intersect (robust least squares). Points that
no camera sees, or for which rays disagree, move with their neighbours. Scene flow from many views follows Vedula et al. 1999.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ...scene.views import Views
from ...vision.flow.chain import Chain

FEWEST_CAMERAS = 2  # least number of cameras that must see a point and agree where it moves
AGREE = 3.0  # px in a picture 640 px wide, between a ray's own pixel and the intersection of all rays, within which the ray agrees
ROUNDS = 4  # rounds of reweighting
NEIGHBOURS = 12
BLOCK = 4  # px, side of a block of the depth map that determines which points are hidden
BEHIND = 0.02  # of the depth, by which a visible point may lie behind the nearest one in its block


def next_positions(
    views: Views, chains: list[tuple[Chain, list[int]]], k: int, direction: int, points: np.ndarray, alive: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Positions of ``points`` [N, 3] of time ``k`` at the next time (direction 1) or the previous (-1), and which of the ``alive`` [N] are
    still tracked."""
    rays = np.zeros((len(chains), len(points), 3))
    seen = np.zeros((len(chains), len(points)), bool)
    centres = views.centres()
    for row, (chain, frames) in enumerate(chains):
        i, j = frames[k], frames[k + direction]
        shown = _first_in_line(views, i, points)
        shown = shown[alive[shown]]
        places = places_of(views, i, points[shown])
        x, y = (np.clip(np.rint(places[:, c]).astype(int), 0, size - 1) for c, size in enumerate((views.width, views.height)))
        on = chain.mask(k)[y, x]
        moved = chain.move(k, direction, places)
        if moved is None:
            continue
        use = on & moved[1]
        shown, places = shown[use], moved[0][use]
        K, pose = views.K[j], views.cam_from_world[j]
        ray = np.concatenate([(places + 0.5 - K[:2, 2]) / K[[0, 1], [0, 1]], np.ones((len(places), 1))], 1) @ pose[:3, :3]
        rays[row, shown] = ray / np.linalg.norm(ray, axis=1, keepdims=True)
        seen[row, shown] = True
    ends = np.array([centres[frames[k + direction]] for _, frames in chains])
    focal = float(np.median(views.K[views.train, 0, 0]))
    found, agreed = meet(ends, rays, seen, points, AGREE * views.width / 640 / focal)
    return _with_neighbours(points, found - points, agreed & alive, alive)


def places_of(views: Views, i: int, points: np.ndarray) -> np.ndarray:
    """Where frame ``i`` shows ``points`` [N, 3], [N, 2] px as in `Chain`: pixel centres are at whole numbers. NaN behind the camera."""
    K, pose = views.K[i], views.cam_from_world[i]
    cam = points @ pose[:3, :3].T + pose[:3, 3]
    z = np.where(cam[:, 2:] > 0, cam[:, 2:], np.nan)
    return np.asarray(cam[:, :2] / z * K[[0, 1], [0, 1]] + K[:2, 2] - 0.5)


def meet(centres: np.ndarray, rays: np.ndarray, seen: np.ndarray, start: np.ndarray, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """The points [N, 3] nearest to the unit ``rays`` [C, N, 3] from ``centres`` [C, 3] where ``seen`` [C, N], and whether at least two rays
    pass within ``angle`` (radians) of them. Cauchy weights suppress rays that disagree. Directions that the rays leave open stay at
    ``start`` [N, 3]."""
    projector = np.eye(3) - rays[..., :, None] * rays[..., None, :]
    found = start.astype(np.float64)
    for r in range(ROUNDS + 1):
        offset = found[None] - centres[:, None]
        distance = np.maximum(np.linalg.norm(offset, axis=2), 1e-12)
        off = np.linalg.norm(np.einsum("cnij,cnj->cni", projector, offset), axis=2) / distance
        weight = seen / distance**2 / (1 + (off / angle) ** 2 if r else 1.0)
        if r == ROUNDS:
            break
        A = np.einsum("cn,cnij->nij", weight, projector)
        b = np.einsum("cn,cnij,cj->ni", weight, projector, centres)
        hold = 1e-3 * np.maximum(np.trace(A, axis1=1, axis2=2), 1e-12)  # a single ray says nothing about its own direction
        found = np.linalg.solve(A + hold[:, None, None] * np.eye(3), (b + hold[:, None] * found)[..., None])[..., 0]
    return found, (seen & (off < angle)).sum(0) >= FEWEST_CAMERAS


def _first_in_line(views: Views, i: int, points: np.ndarray) -> np.ndarray:
    """Indices of the ``points`` [N, 3] that lie in the view of frame ``i`` and that no other of the points hides."""
    shown, x, y, depth = views.project(i, points)
    block = (y // BLOCK) * (views.width // BLOCK + 1) + x // BLOCK
    first = np.full(int(block.max(initial=0)) + 1, np.inf)
    np.minimum.at(first, block, depth)
    return shown[depth <= (1 + BEHIND) * first[block]]


def _with_neighbours(points: np.ndarray, step: np.ndarray, known: np.ndarray, alive: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Moves ``points`` [N, 3] by the median ``step`` [N, 3] of their nearest ``known`` [N] neighbours. A point whose neighbours are far is
    no longer alive."""
    if known.sum() < NEIGHBOURS:
        return points, np.zeros(len(points), bool)
    distance, near = cKDTree(points[known]).query(points, k=NEIGHBOURS)
    spacing = np.median(distance[known, -1])
    moved = points + np.median(step[known][near], axis=1)
    return moved.astype(np.float32), alive & (distance[:, 0] <= 2 * spacing)
