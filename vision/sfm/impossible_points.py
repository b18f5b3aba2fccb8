"""`purge`: removes from a reconstruction what no camera can have seen. Works on a pycolmap model, but does not import pycolmap.

A reprojection error is defined only for a point in front of its camera. For a point behind it, COLMAP reports the largest double, and one
such point among 20 000 makes the mean 1e150 px. Under Cauchy's loss an outlier can drift there, since it costs little more at 1000 px than
at 100.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pycolmap

MAX_ERROR = 4.0  # px of an observation; the mapper's own limit
MIN_ANGLE = 1.0  # degrees between the outermost rays of a point; the mapper requires 1.5, and the last adjustment may reduce it
FEWEST = 10  # observations that a pose needs; the mapper registers with 30


@dataclass(frozen=True)
class Observations:
    """One row for every feature that belongs to a point, sorted by point and image.

    image, feature, point [O] int64: COLMAP's image id, the feature's number in the image, the point's id. xy [O, 2] px: the feature.
    depth [O]: of the point along the camera's axis, world units. error [O] px: distance from the feature to the projected point, inf if
    the point is not in front of the camera. ray [O, 3]: unit direction from the camera to the point, NaN if there is none.
    """

    image: np.ndarray
    feature: np.ndarray
    point: np.ndarray
    xy: np.ndarray
    depth: np.ndarray
    error: np.ndarray
    ray: np.ndarray


@dataclass
class Purged:
    """What `purge` removed: counts of observations and points, names of images."""

    observations: int = 0
    points: int = 0
    images: list[str] = field(default_factory=list)

    def __bool__(self) -> bool:
        return bool(self.observations or self.points or self.images)


def observe(model: pycolmap.Reconstruction) -> Observations:
    """All observations of registered images, with depth, error and ray under their cameras."""
    columns: list[tuple[np.ndarray, ...]] = []
    empty = np.zeros(0, np.int64)
    columns.append((empty, empty, empty, np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros((0, 3))))
    for image_id in sorted(model.reg_image_ids()):
        image = model.image(image_id)
        numbers = np.array(image.get_observation_point2D_idxs(), np.int64)
        if not len(numbers):
            continue
        features = image.get_observation_points2D()
        ids = np.array([feature.point3D_id for feature in features], np.int64)
        xy = np.array([feature.xy for feature in features])
        pose = image.cam_from_world().matrix()
        with np.errstate(all="ignore"):
            local = np.array([model.point3D(int(k)).xyz for k in ids]) @ pose[:, :3].T + pose[:, 3]
            good = np.isfinite(local).all(axis=1) & (local[:, 2] > 0)
            error, ray = np.full(len(ids), np.inf), np.full((len(ids), 3), np.nan)
            if good.any():
                seen = np.asarray(model.camera(image.camera_id).img_from_cam(local[good]))
                error[good] = np.nan_to_num(np.linalg.norm(seen - xy[good], axis=1), nan=np.inf)
                ray[good] = local[good] / np.linalg.norm(local[good], axis=1, keepdims=True) @ pose[:, :3]
        columns.append((np.full(len(ids), image_id), numbers, ids, xy, local[:, 2], error, ray))
    image_, feature, point, xy, depth, error, ray = (np.concatenate(column) for column in zip(*columns, strict=True))
    order = np.lexsort((feature, image_, point))
    return Observations(image_[order], feature[order], point[order], xy[order], depth[order], error[order], ray[order])


def groups(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and one-past-last row of every point in a sorted column of ids [O]: two [P] int64."""
    starts = np.flatnonzero(np.diff(point, prepend=-1))
    return starts, np.append(starts[1:], len(point))[: len(starts)]


def angles(seen: Observations, good: np.ndarray) -> np.ndarray:
    """[P] degrees between the outermost rays of every point, using only the rows `good` [O]; 0 for fewer than two rays."""
    starts, ends = groups(seen.point)
    widest = np.zeros(len(starts))
    for n, (start, end) in enumerate(zip(starts, ends, strict=True)):
        rays = seen.ray[start:end][good[start:end]]
        if len(rays) > 1:
            widest[n] = np.degrees(np.arccos(np.clip((rays @ rays.T).min(), -1.0, 1.0)))
    return widest


def purge(model: pycolmap.Reconstruction) -> Purged:
    """Removes in place: observations off by more than `MAX_ERROR` px or of points not in front of the camera; points without finite
    coordinates, with fewer than two observations left, or seen under less than `MIN_ANGLE` degrees; and poses that are not finite or that
    have fewer than `FEWEST` observations. Removing a pose removes its observations, so this repeats until nothing is left to remove.
    """
    purged = Purged()
    while True:
        for image_id in sorted(model.reg_image_ids()):
            if not np.isfinite(model.image(image_id).cam_from_world().matrix()).all():
                _deregister(model, image_id, purged)
        for key in [key for key, point in model.points3D.items() if not point.track.length() or not np.isfinite(point.xyz).all()]:
            model.delete_point3D(key)
            purged.points += 1
        seen = observe(model)
        good = seen.error <= MAX_ERROR
        starts, ends = groups(seen.point)
        hopeless = angles(seen, good) < MIN_ANGLE
        purged.points += int(hopeless.sum())
        for key in seen.point[starts[hopeless]]:
            model.delete_point3D(int(key))
        stray = ~good & ~np.repeat(hopeless, ends - starts)
        purged.observations += int(stray.sum())
        for image_id, feature in zip(seen.image[stray], seen.feature[stray], strict=True):
            model.delete_observation(int(image_id), int(feature))
        weak = [i for i in sorted(model.reg_image_ids()) if len(model.image(i).get_observation_point2D_idxs()) < FEWEST]
        if not weak:
            return purged
        for image_id in weak:
            _deregister(model, image_id, purged)


def _deregister(model: pycolmap.Reconstruction, image_id: int, purged: Purged) -> None:
    purged.images.append(model.image(image_id).name)
    model.deregister_frame(model.image(image_id).frame_id)
