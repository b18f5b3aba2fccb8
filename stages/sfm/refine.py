"""`refine`: all cameras and points of a reconstruction adjusted together, outliers counting for little. Worker: imports pycolmap."""

from __future__ import annotations

import numpy as np
import pycolmap

ROUNDS = 2  # the first one's noise is measured on cameras that outliers have pulled; a third changes nothing
CAUCHY = 2.385  # standard deviations; Cauchy's loss then has 95 % of the efficiency of least squares on Gaussians
MEDIAN_OF_NORM = 1.1774  # of a Gaussian in two dimensions, in standard deviations: sqrt(2 log 2)
FINEST = 0.01  # px; exact features have no noise to measure
ITERATIONS = 50
TOLERANCE = 1e-6  # relative change of the cost


def refine(model: pycolmap.Reconstruction) -> None:
    """Bundle adjustment in place under Cauchy's loss, scaled by the noise of the features that this model uses.

    The mapper adjusts by least squares and keeps features up to 4 px off, ten times the noise and more: a few of these, on what moves or
    mistaken for something else, pull focal length and poses. Principal points stay, as in the mapper. One thread: the same bits each time.
    """
    for _ in range(ROUNDS):
        errors = reprojection_errors(model)
        if not len(errors):
            return
        options = pycolmap.BundleAdjustmentOptions()
        options.print_summary = False
        options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
        options.ceres.loss_function_scale = max(FINEST, CAUCHY * float(np.median(errors)) / MEDIAN_OF_NORM)
        options.ceres.solver_options.num_threads = 1
        options.ceres.solver_options.max_num_iterations = ITERATIONS
        options.ceres.solver_options.function_tolerance = TOLERANCE
        pycolmap.bundle_adjustment(model, options)
    model.update_point_3d_errors()


def reprojection_errors(model: pycolmap.Reconstruction) -> np.ndarray:
    """[O] px: distance of every feature that made a point to where its camera sees the point."""
    errors = [np.zeros(0)]
    for image_id in sorted(model.reg_image_ids()):
        image = model.image(image_id)
        features = image.get_observation_points2D()
        if features:
            points = np.array([model.point3D(feature.point3D_id).xyz for feature in features])
            local = points @ image.cam_from_world().rotation.matrix().T + image.cam_from_world().translation
            seen = model.camera(image.camera_id).img_from_cam(local)
            errors.append(np.linalg.norm(seen - np.array([feature.xy for feature in features]), axis=1))
    found = np.concatenate(errors)
    return found[np.isfinite(found)]
