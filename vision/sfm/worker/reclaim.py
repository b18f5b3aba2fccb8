"""`reclaim`: finds poses for images that the mapper left out of the largest model. Runs in the worker process: imports pycolmap.

There are two sources. If the mapper started twice and neither model reached the other, a second model that shares images with the first
is aligned to it by their common points. Then single images are tried again with fewer inliers than the mapper requires, if neighbours in
time have poses that limit where they can be.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pycolmap

from ..alignment import robust_similarity
from ..impossible_points import purge
from ..plausible import plausible

INLIERS = 15  # of an image that is tried again (the mapper: 30); chance gives less than one at 12 px
INLIER_RATIO = 0.1  # the mapper: 0.25; blurred frames and frames full of moving objects have less
MIN_MATCHES = 15  # of a pair, as in the mapper
ROUNDS = 3  # a frame that is registered may help its neighbour
PASSES = 2  # of the mapper's adjustment, after all reclaimed images are in


def reclaim(
    model: pycolmap.Reconstruction,
    others: Sequence[pycolmap.Reconstruction],
    database: Path,
    order: dict[str, tuple[int, int]],
    fixed_lens: bool,
    seed: int,
) -> tuple[pycolmap.Reconstruction, list[str], list[str]]:
    """`(model, merged, again)`: the model with more images, and the names of those from other models and of those that were tried again.

    order: (camera, frame) of every image by name if the images are in order of time. Empty if they are not; then no image is tried
    alone. The given model is not changed; it is returned itself if nothing was gained.
    """
    grown = pycolmap.Reconstruction(model)
    poses = _poses_of_others(grown, others)
    with pycolmap.Database.open(database) as opened:
        options = pycolmap.DatabaseCacheOptions()
        options.min_num_matches = MIN_MATCHES
        cache = pycolmap.DatabaseCache.create(opened, options)
    mapper = pycolmap.IncrementalMapper(cache)
    mapper.begin_reconstruction(grown)
    settings, triangulation = _options(fixed_lens, seed)
    merged = []
    for image_id in sorted(poses):
        image = grown.image(image_id)
        grown.frame(image.frame_id).set_cam_from_world(image.camera_id, poses[image_id])
        mapper.observation_manager.register_frame(image.frame_id)
        mapper.triangulate_image(triangulation, image_id)
        merged.append(image.name)
    again = _try_again(mapper, grown, order, settings, triangulation) if order else []
    if merged or again:
        adjustment = pycolmap.BundleAdjustmentOptions()
        adjustment.print_summary = False
        adjustment.refine_focal_length = adjustment.refine_extra_params = not fixed_lens
        adjustment.ceres.solver_options.num_threads = 1
        mapper.iterative_global_refinement(PASSES, 5e-4, settings, adjustment, triangulation, False)
    mapper.end_reconstruction(False)
    if not (merged or again):
        return model, [], []
    purge(grown)
    left = _names(grown)
    if len(left) <= model.num_reg_images() or not _names(model) <= left:
        return model, [], []
    return grown, [name for name in merged if name in left], [name for name in again if name in left]


def _names(model: pycolmap.Reconstruction) -> set[str]:
    return {model.image(i).name for i in model.reg_image_ids()}


def _poses_of_others(model: pycolmap.Reconstruction, others: Sequence[pycolmap.Reconstruction]) -> dict[int, pycolmap.Rigid3d]:
    """Poses, in the world of `model`, of images that only other models have. Models that can be aligned are used, the largest first."""
    found: dict[int, pycolmap.Rigid3d] = {}
    mine = set(model.reg_image_ids())
    for other in sorted(others, key=lambda m: -m.num_reg_images()):
        theirs = set(other.reg_image_ids())
        if not theirs - mine - set(found):
            continue
        common = sorted(mine & theirs)
        transform = robust_similarity(*_common_points(other, model, common))
        if transform is None:
            continue
        scale, R, t = transform
        aligned = pycolmap.Reconstruction(other)
        aligned.transform(pycolmap.Sim3d(scale, pycolmap.Rotation3d(R), t))
        for image_id in sorted(theirs - mine):
            found.setdefault(image_id, aligned.image(image_id).cam_from_world())
    return found


def _common_points(
    source: pycolmap.Reconstruction, target: pycolmap.Reconstruction, common: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of points that belong to the same features of the common images in both models: two arrays [N, 3]."""
    pairs = {}
    for image_id in common:
        a, b = source.image(image_id), target.image(image_id)
        both = sorted(set(a.get_observation_point2D_idxs()) & set(b.get_observation_point2D_idxs()))
        for n in both:
            pairs[a.point2D(n).point3D_id] = b.point2D(n).point3D_id
    first = np.array([source.point3D(k).xyz for k in pairs]).reshape(-1, 3)
    second = np.array([target.point3D(k).xyz for k in pairs.values()]).reshape(-1, 3)
    return first, second


def _options(fixed_lens: bool, seed: int) -> tuple[pycolmap.IncrementalMapperOptions, pycolmap.IncrementalTriangulatorOptions]:
    settings, triangulation = pycolmap.IncrementalMapperOptions(), pycolmap.IncrementalTriangulatorOptions()
    settings.random_seed = triangulation.random_seed = seed
    settings.num_threads = 1
    settings.abs_pose_min_num_inliers, settings.abs_pose_min_inlier_ratio = INLIERS, INLIER_RATIO
    # a few points do not determine the lens, which is taken from the other images
    settings.abs_pose_refine_focal_length = settings.abs_pose_refine_extra_params = False
    return settings, triangulation


def _try_again(
    mapper: pycolmap.IncrementalMapper,
    model: pycolmap.Reconstruction,
    order: dict[str, tuple[int, int]],
    settings: pycolmap.IncrementalMapperOptions,
    triangulation: pycolmap.IncrementalTriangulatorOptions,
) -> list[str]:
    names: list[str] = []
    for _ in range(ROUNDS):
        before = len(names)
        for image_id in mapper.find_next_images(settings, False):
            name = model.image(image_id).name
            if name not in order or not mapper.register_next_image(settings, image_id):
                continue
            if _plausible(model, image_id, order):
                mapper.triangulate_image(triangulation, image_id)
                names.append(name)
            else:
                mapper.observation_manager.deregister_frame(model.image(image_id).frame_id)
        if len(names) == before:
            break
    return names


def _plausible(model: pycolmap.Reconstruction, image_id: int, order: dict[str, tuple[int, int]]) -> bool:
    image = model.image(image_id)
    camera, frame = order[image.name]
    known = sorted(
        (order[model.image(i).name][1], i) for i in model.reg_image_ids() if i != image_id and order[model.image(i).name][0] == camera
    )
    if not known:
        return False
    poses = [model.image(i).cam_from_world().rotation.matrix() for _, i in known]
    centres = [model.image(i).projection_center() for _, i in known]
    mine = image.cam_from_world().rotation.matrix()
    return plausible(image.projection_center(), mine, frame, np.array([n for n, _ in known]), np.array(centres), np.array(poses))
