"""`refine`: adjusts all cameras and points of a reconstruction together, with little weight for outliers. Runs in the worker process:
imports pycolmap."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pycolmap

from ..impossible_points import Purged, observe, purge
from .lens import lens_trouble

ROUNDS = 2  # in the first, the noise is measured with cameras that outliers have biased; a third round changes nothing
CAUCHY = 2.385  # standard deviations; Cauchy's loss then has 95 % of the efficiency of least squares on Gaussian errors
MEDIAN_OF_NORM = 1.1774  # of a Gaussian in two dimensions, in standard deviations: sqrt(2 log 2)
FINEST = 0.01  # px; exact features have no noise to measure
ITERATIONS = 50
TOLERANCE = 1e-4  # relative change of the cost; with a hundredth of it, errors of made clips were 2 and 4 % smaller, and it took longer
WORSE = 1.05, 0.01  # factor and px by which the median error may grow
KEPT = 0.9  # share of the observations that must still fit after an adjustment


def refine(model: pycolmap.Reconstruction, fixed_lens: bool = False) -> None:
    """Bundle adjustment in place under Cauchy's loss, scaled by the noise of the features that this model uses.

    The mapper adjusts by least squares and keeps features up to 4 px off, ten times the noise or more. A few of these, on moving objects or
    wrongly matched, bias focal length and poses. Principal points stay fixed, as in the mapper; with `fixed_lens` the whole lens does. One
    thread, so that results are bit-identical. Every observation must be of a finite point in front of its camera (`purge`).
    """
    for _ in range(ROUNDS):
        errors = observe(model).error
        if not len(errors):
            return
        options = pycolmap.BundleAdjustmentOptions()
        options.print_summary = False
        options.refine_focal_length = options.refine_extra_params = not fixed_lens
        options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
        options.ceres.loss_function_scale = max(FINEST, CAUCHY * float(np.median(errors)) / MEDIAN_OF_NORM)
        # Conjugate gradients, where there are too many images for dense matrices: as accurate as sparse ones, in half of the time.
        options.ceres.max_num_images_direct_sparse_cpu_solver = options.ceres.max_num_images_direct_dense_cpu_solver + 1
        options.ceres.solver_options.num_threads = 1
        options.ceres.solver_options.max_num_iterations = ITERATIONS
        options.ceres.solver_options.function_tolerance = TOLERANCE
        pycolmap.bundle_adjustment(model, options)


def refine_or_keep(
    model: pycolmap.Reconstruction, fixed_lens: bool = False, adjust: Callable[[pycolmap.Reconstruction, bool], None] = refine
) -> tuple[pycolmap.Reconstruction, Purged, str | None]:
    """`(model, purged, undone)`: the model purged, adjusted and purged again; or the model before the adjustment, and why it was undone.

    `purged` counts what was removed before and after the adjustment together. The given model is not changed.
    """
    before = pycolmap.Reconstruction(model)
    first = purge(before)
    if not before.num_points3D():
        return before, first, None
    after = pycolmap.Reconstruction(before)
    adjust(after, fixed_lens)
    second = purge(after)
    why = worse(before, after)
    if why is not None:
        return before, first, why
    return after, Purged(first.observations + second.observations, first.points + second.points, first.images + second.images), None


def worse(before: pycolmap.Reconstruction, after: pycolmap.Reconstruction) -> str | None:
    """In what way an adjusted, purged model is worse than before; None if it is not."""
    if after.num_reg_images() < before.num_reg_images():
        return f"{before.num_reg_images() - after.num_reg_images()} images lost their poses"
    was, now = observe(before).error, observe(after).error
    if len(now) < KEPT * len(was):
        return f"{len(was) - len(now)} of {len(was)} observations no longer fit"
    factor, pixels = WORSE
    if np.median(now) > factor * np.median(was) + pixels:
        return f"the median error grew from {np.median(was):.2f} to {np.median(now):.2f} px"
    return lens_of(after, before)


def lens_of(model: pycolmap.Reconstruction, before: pycolmap.Reconstruction | None = None) -> str | None:
    """What is absurd about a lens of the model that was not absurd `before`; None if there is no such lens."""
    for camera_id in sorted({model.image(i).camera_id for i in model.reg_image_ids()}):
        camera = model.camera(camera_id)
        trouble = trouble_of(camera)
        if trouble is not None and (before is None or trouble_of(before.camera(camera_id)) is None):
            return trouble
    return None


def trouble_of(camera: pycolmap.Camera) -> str | None:
    """`lens_trouble` of a COLMAP camera."""
    hinted = bool(camera.has_prior_focal_length)
    return lens_trouble(camera.calibration_matrix(), np.array(distortion(camera)), camera.width, camera.height, hinted)


def distortion(camera: pycolmap.Camera) -> tuple[float, float, float, float]:
    """(k1, k2, p1, p2) of a COLMAP camera model that has no other distortion terms."""
    extra = [float(camera.params[i]) for i in camera.extra_params_idxs()]
    k1, k2, p1, p2 = (*extra, 0.0, 0.0, 0.0, 0.0)[:4]
    return k1, k2, p1, p2
