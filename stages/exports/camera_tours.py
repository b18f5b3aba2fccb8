"""Ways from camera to camera that keep their distance from the scene: around it instead of straight through.

Poses are cam_from_world [n, 4, 4], OpenCV (x right, y down, z forward), world units.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ...scene.camera_paths import along, centres, look_at

JUMP = 20.0  # degrees by which one camera does not turn from one picture to the next
STEEPEST = np.radians(89.9)  # above or below the horizon; straight above, "around" has no meaning
ROUNDS = 100  # over the stops in search of a shorter way, at most; it ends when none helps


def separate(poses: np.ndarray) -> bool:
    """Whether ``poses``, in order, are those of separate cameras rather than of one that moves: most of them look elsewhere than the one
    before, by more than `JUMP`."""
    return len(poses) > 1 and float(np.median(turns(poses))) > JUMP


def turns(poses: np.ndarray) -> np.ndarray:
    """[n - 1] degrees by which each of ``poses`` is turned against the one before."""
    relative = np.einsum("nij,nkj->nik", poses[1:, :3, :3], poses[:-1, :3, :3])
    return np.degrees(np.arccos(np.clip((np.trace(relative, axis1=1, axis2=2) - 1) / 2, -1, 1)))


def tour(poses: np.ndarray, centre: np.ndarray, most: int) -> np.ndarray:
    """Indices of at most ``most`` of ``poses``, spread over all the directions from which they see ``centre`` [3], in the order of a short
    way from one to the next. It begins with the first."""
    offset = centres(poses) - centre
    directions = offset / np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), 1e-12)
    chosen, nearest = [0], np.full(len(poses), np.inf)
    while len(chosen) < min(most, len(poses)):
        nearest = np.minimum(nearest, np.linalg.norm(directions - directions[chosen[-1]], axis=1))
        nearest[chosen] = -1.0
        chosen.append(int(nearest.argmax()))
    return np.array(chosen)[_short_way(directions[chosen])]


def _short_way(places: np.ndarray) -> list[int]:
    """An order of ``places`` [n, 3] that begins with the first and makes a short way: always on to the nearest, then pieces turned round as
    long as that makes it shorter (2-opt)."""
    lengths = np.linalg.norm(places[:, None] - places[None], axis=2)
    order, left = [0], set(range(1, len(places)))
    while left:
        order.append(min(left, key=lambda k: (lengths[order[-1], k], k)))
        left.remove(order[-1])
    for _ in range(ROUNDS):
        shorter = False
        for i in range(1, len(order) - 1):
            for j in range(i + 1, len(order)):
                before = lengths[order[i - 1], order[i]] + (lengths[order[j], order[j + 1]] if j + 1 < len(order) else 0.0)
                after = lengths[order[i - 1], order[j]] + (lengths[order[i], order[j + 1]] if j + 1 < len(order) else 0.0)
                if after < before - 1e-9:
                    order[i : j + 1] = order[i : j + 1][::-1]
                    shorter = True
        if not shorter:
            break
    return order


def travelled(poses: np.ndarray, at: np.ndarray, centre: np.ndarray, up: np.ndarray) -> np.ndarray:
    """[m, 4, 4] at the places ``at`` [m] in [0, n - 1] of the way through ``poses`` in order.

    Neighbours that differ by more than `JUMP` are joined by a way around ``centre`` [3] about the axis ``up`` [3], on which distance and
    height angle change evenly, so that it stays between their distances; all others, and those that do not both see ``centre`` ahead, by
    a straight line.
    """
    way = along(poses, len(at), at)
    if len(poses) == 1:
        return way
    ahead = (poses[:, :3, :3] @ centre + poses[:, :3, 3])[:, 2] > 0
    wide = (turns(poses) > JUMP) & ahead[1:] & ahead[:-1]
    begin = np.clip(np.floor(at).astype(int), 0, len(poses) - 2)
    for k in np.flatnonzero(wide[begin]):
        way[k] = _around(poses[begin[k]], poses[begin[k] + 1], float(at[k] - begin[k]), centre, up)
    return way


def _around(a: np.ndarray, b: np.ndarray, share: float, centre: np.ndarray, up: np.ndarray) -> np.ndarray:
    """The pose at ``share`` of the way from ``a`` to ``b`` about ``centre``. The camera keeps its turn against one that faces the centre,
    or changes it evenly to that of ``b``."""
    side = np.cross(up, [1.0, 0, 0] if abs(up[0]) < 0.9 else [0, 1.0, 0])
    side /= np.linalg.norm(side)
    axes = np.stack([side, np.cross(up, side), up])
    placed = [axes @ (centres(pose[None])[0] - centre) for pose in (a, b)]
    radii = [max(float(np.linalg.norm(p)), 1e-12) for p in placed]
    heights = [float(np.clip(np.arcsin(np.clip(p[2] / r, -1, 1)), -STEEPEST, STEEPEST)) for p, r in zip(placed, radii)]
    bearings = [float(np.arctan2(p[1], p[0])) for p in placed]
    wanted = (bearings[1] - bearings[0] + np.pi) % (2 * np.pi) - np.pi  # the shorter way round

    def facing(height: float, bearing: float, radius: float) -> np.ndarray:
        flat = np.cos(height)
        return look_at(centre + axes.T @ (radius * np.array([flat * np.cos(bearing), flat * np.sin(bearing), np.sin(height)])), centre, up)

    def between(pair: list[float]) -> float:
        return (1 - share) * pair[0] + share * pair[1]

    bases = [facing(h, g, r)[:3, :3] for h, g, r in zip(heights, (bearings[0], bearings[0] + wanted), radii)]
    own = Rotation.from_matrix([pose[:3, :3] @ base.T for pose, base in zip((a, b), bases)])
    result = facing(between(heights), bearings[0] + share * wanted, between(radii))
    eye = centres(result[None])[0]
    result[:3, :3] = Slerp([0, 1], own)([share]).as_matrix()[0] @ result[:3, :3]
    result[:3, 3] = -result[:3, :3] @ eye
    return result
