"""Depth of moving objects seen by one moving camera. The camera cannot measure it, but the static scene behind and below bounds it.

An object that stands on the floor is as far away as the floor at its lowest pixel, or nearer if the picture border cuts it off. Any other
object is only known to be nearer than what it hides. Objects keep their size, so the depth from one frame gives it for all
(`vision/moving/followed_parts.py`).
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from ...scene.views import Views
from ...vision.moving.followed_parts import Objects, inner
from ..depth.artifact import StoredDepth
from .given_objects import given_numbers, given_surface

NEAR = 5.0  # percentile of the depths of hidden points that counts as the nearest, since single points may be wrong
FEWEST = 5  # least number of hidden points, or points of the floor, that give a depth
BEFORE = 0.97  # factor on the depth of hidden points: an object is in front of what it hides
ANYWHERE = 0.75  # the same for an object in the air: the mean over all positions in the view in front of what it hides
TIGHTEST = 20.0  # percentile of an object's depths over its frames; low, since each is an upper bound or noisy
STANDS = 0.75  # of the frames that show a surface below an object must show a level one for the object to count as standing
BESIDE = 8  # frames on either side whose own evidence is used
FLOOR = 0.6  # least vertical share of a surface's normal for objects to stand on it: at most 53 degrees from level
AROUND_FOOT = 0.08  # of the picture's width, reach around the lowest pixel within which points of the floor are used
THICKEST = 0.7  # least factor on the depth for the thickness of an object, away from its outline
STEADY = 9  # frames in the moving median of a track's depth


def object_depths(
    objects: Objects, views: Views, frames: list[int], points: np.ndarray, given: StoredDepth | None = None
) -> list[np.ndarray]:
    """For each of ``frames`` the depth of each part, [labels] in world units; 0 if the static ``points`` [P, 3] do not determine it. given:
    depth of the capture, which replaces all other evidence where it covers a part."""
    told: dict[int, _Told] = {}
    for k, (labels, number, log_size, i) in enumerate(zip(objects.labels, objects.number, objects.log_size, frames)):
        _, x, y, z = views.project(i, points)
        row, column = objects.at(k, x, y)
        without_rim = inner(labels)
        K = np.diag([1 / objects.step[0], 1 / objects.step[1], 1.0]) @ views.K[i]
        for part in range(1, len(number)):
            known = told.setdefault(int(number[part]), _Told([], [], 0))
            below = depth_below(labels == part, K, column, row, z)
            hidden = z[without_rim[row, column] == part]
            if below is not None and below.level:
                known.floor.append((k, np.log(below.depth) + log_size[part]))
            elif below is not None:
                told[int(number[part])] = known._replace(in_air=known.in_air + 1)
            if len(hidden) >= FEWEST:
                known.hidden.append((k, np.log(np.percentile(hidden, NEAR)) + log_size[part]))
    depths = []
    for k, (number, log_size) in enumerate(zip(objects.number, objects.log_size)):
        depths.append(np.zeros(len(number), np.float32))
        for part in range(1, len(number)):
            depths[k][part] = _depth(told[int(number[part])], k, float(log_size[part]))
    return depths if given is None else given_numbers(objects, frames, given, depths)


class _Told(NamedTuple):
    """Evidence for one object: (frame, log(depth * size)) from the floor below it and from what it hides, and the number of frames in which
    the surface below is not level."""

    floor: list[tuple[int, float]]
    hidden: list[tuple[int, float]]
    in_air: int


def _depth(told: _Told, k: int, log_size: float) -> float:
    """Depth of an object in frame ``k``; 0 without evidence."""
    stands = len(told.floor) > 0 and len(told.floor) >= STANDS * (len(told.floor) + told.in_air)
    evidence = told.floor if stands else told.hidden
    if not evidence:
        return 0.0
    frame, value = np.array(evidence).T
    beside = value[np.abs(frame - k) <= BESIDE]  # measured sizes drift over time and as the object turns
    tightest = np.percentile(value, TIGHTEST)
    share = 1.0 if stands else ANYWHERE if told.in_air else BEFORE
    return share * float(np.exp(min(tightest, np.median(beside) if len(beside) else tightest) - log_size))


class Below(NamedTuple):
    """depth: world units, of the surface seen below an object. level: whether objects can stand on that surface."""

    depth: float
    level: bool


def depth_below(part: np.ndarray, K: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> Below | None:
    """Depth at the lowest pixel of ``part`` [H, W] bool of the surface formed by the points at pixels ``x``, ``y`` with depths ``z`` [P];
    None if these are too few or form no surface. K: intrinsics [3, 3] in px."""
    rows, columns = np.nonzero(part)
    foot_y = rows.max()
    foot_x = float(np.median(columns[rows >= foot_y - 0.02 * (foot_y - rows.min() + 1)]))
    reach = AROUND_FOOT * part.shape[1]
    near = (np.abs(x - foot_x) < reach) & (y - foot_y > -0.3 * reach) & (y - foot_y < 1.5 * reach)
    if near.sum() < FEWEST:
        return None
    # The inverse depth of a plane is affine in the pixel position. Reweighting reduces the influence of points that are not on the floor.
    ray_x, ray_y = (x[near] + 0.5 - K[0, 2]) / K[0, 0], (y[near] + 0.5 - K[1, 2]) / K[1, 1]
    rays, inverse = np.stack([ray_x, ray_y, np.ones(near.sum())], 1), 1 / z[near]
    weight = np.ones(len(inverse))
    for _ in range(10):
        plane = np.linalg.lstsq(rays * weight[:, None], inverse * weight, rcond=None)[0]
        off = np.abs(rays @ plane - inverse)
        weight = 1 / np.sqrt(1 + (off / (1.5 * np.median(off) + 1e-9 * inverse.max())) ** 2)
    at_foot = float(plane @ [(foot_x + 0.5 - K[0, 2]) / K[0, 0], (foot_y + 0.5 - K[1, 2]) / K[1, 1], 1.0])
    if not inverse.min() / 2 < at_foot < 2 * inverse.max():
        return None
    return Below(1 / at_foot, bool(plane[1] > FLOOR * np.linalg.norm(plane)))


def depth_at(
    objects: Objects,
    depths: np.ndarray,
    K: np.ndarray,
    k: int,
    places: np.ndarray,
    usual: float,
    given: StoredDepth | None = None,
    i: int = 0,
) -> np.ndarray:
    """Depth [n] of pixels ``places`` [n, 2] of frame ``k``, whose parts have ``depths`` [labels]; ``usual`` for parts without a depth.
    A part is assumed to be as thick as it is wide, so its surface comes nearer with the distance from its outline, unless there is
    ``given`` depth of frame ``i``."""
    return surface(objects, depths, K, k, usual, given, i)[objects.at(k, *places.T)]


def surface(
    objects: Objects, depths: np.ndarray, K: np.ndarray, k: int, usual: float, given: StoredDepth | None = None, i: int = 0
) -> np.ndarray:
    """`depth_at` of all pixels of the labels of frame ``k``: [h, w]."""
    labels = objects.labels[k]
    z = depths[labels]
    if given is not None and i in given.z:
        return given_surface(given, i, labels, np.where(z > 0, z, usual))
    inside = cv2.distanceTransform((labels > 0).astype(np.uint8), cv2.DIST_L2, 5)
    return np.where(z > 0, z, usual) * np.maximum(1 - inside * objects.step[0] / K[0, 0], THICKEST)


def steady(depth: np.ndarray, alive: np.ndarray) -> np.ndarray:
    """Moving median of ``depth`` [F, n] over `STEADY` frames, counting only those in which the track is ``alive`` [F, n]."""
    values = np.where(alive, depth, np.nan)
    half = STEADY // 2
    padded = np.pad(values, ((half, half), (0, 0)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, STEADY, axis=0)
    order = np.sort(windows, axis=-1)  # NaN sorts last
    count = np.isfinite(order).sum(-1)
    middle = np.take_along_axis(order, np.maximum(count - 1, 0)[..., None] // 2, axis=-1)[..., 0]
    return np.where(count > 0, middle, depth)
