"""`map_images`: maps the images of a database, from a good first pair or, if need be, from worse ones. Runs in the worker process:
imports pycolmap."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pycolmap

from .features.database import Report
from .refine import TOLERANCE, lens_of

ENOUGH = 0.5  # of the images; a smaller model may have started from the wrong pair, so another first angle is tried
MOST_MODELS = 4  # separate models that are started; if there are more, none is useful, and each takes minutes
HALF = 0.5  # share of the images of the map with a fitted lens that the map with a fixed lens must have


def map_images(path: Path, request: dict[str, Any], report: Report) -> tuple[list[pycolmap.Reconstruction], bool, list[str]]:
    """`(models, fixed_lens, notes)`: the models, the one with most images first; whether the lens was held fixed; sentences about it.

    If nothing registers, or the resulting lens is absurd (`lens_trouble`), the images are mapped once more with the initial lens held
    fixed: a camera that hardly moves, or moves only along its axis, does not determine its focal length.
    """
    models = map_once(path, request, report, False)
    if request["mapper"] == "global":
        return models, False, []
    trouble = lens_of(models[0]) if models else "no camera"
    if trouble is None:
        return models, False, []
    again = map_once(path, request, report, True)
    if not again or (models and again[0].num_reg_images() < HALF * models[0].num_reg_images()):
        words = f"the adjustment found {trouble}; with a fixed lens fewer images register, so this lens is kept: poses are doubtful"
        return models, False, [words] if models else []
    camera = again[0].camera(again[0].image(min(again[0].reg_image_ids())).camera_id)
    ratio = camera.mean_focal_length() / max(camera.width, camera.height)
    words = (
        f"the pictures do not determine the lens (the adjustment found {trouble}): a focal length of {ratio:.2f} times the longer side is "
        "taken; provide poses or intrinsics in the files (transforms.json) if you know better"
    )
    return again, True, [words]


def map_once(path: Path, request: dict[str, Any], report: Report, fixed_lens: bool) -> list[pycolmap.Reconstruction]:
    """The mapper's models, the one with most images first. The first pair has the widest angle that registers half of the images."""
    root, out = Path(request["root"]), Path(request["folder"]) / "models"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    total = len(request["names"])
    report("mapping", 0, total)
    if request["mapper"] == "global":
        overall = pycolmap.GlobalPipelineOptions()
        overall.random_seed = overall.mapper.random_seed = int(request["seed"])
        models = list(pycolmap.global_mapping(path, root, out, overall).values())
        for model in models:
            model.extract_colors_for_all_images(root)
        return _sorted(models)

    options = _options(request, fixed_lens)
    registered = 0

    def advance() -> None:
        nonlocal registered
        registered += 1
        report("mapping", min(registered, total), total)

    best: list[pycolmap.Reconstruction] = []
    for angle in request["init_angles"]:  # a camera that hardly moves has no pair with the usual first angle
        options.mapper.init_min_tri_angle = angle
        registered = 0
        models = _sorted(list(pycolmap.incremental_mapping(path, root, out, options, next_image_callback=advance).values()))
        if models and (not best or models[0].num_reg_images() > best[0].num_reg_images()):
            best = models
        if best and best[0].num_reg_images() >= max(min(3, total), ENOUGH * total):
            break
    return best


def _sorted(models: list[pycolmap.Reconstruction]) -> list[pycolmap.Reconstruction]:
    return sorted(models, key=lambda m: (m.num_reg_images(), m.num_points3D()), reverse=True)


def _options(request: dict[str, Any], fixed_lens: bool) -> pycolmap.IncrementalPipelineOptions:
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = int(request["seed"])
    options.num_threads = options.mapper.num_threads = 1
    # A full adjustment each time frames or points grow by 30 % is as accurate as one each 10 %, and adjustments take most of the time.
    options.ba_global_frames_ratio = options.ba_global_points_ratio = 1.3
    options.ba_global_max_refinements = 3
    # COLMAP's own tolerance is zero: it goes on when nothing changes any more.
    options.ba_global_function_tolerance = TOLERANCE
    options.mapper.ba_global_ignore_redundant_points3D = True  # cameras are adjusted to some points, then the others to the cameras
    options.max_num_models = MOST_MODELS
    options.min_model_size = min(options.min_model_size, max(2, len(request["names"]) // 2))
    if fixed_lens:
        options.ba_refine_focal_length = options.ba_refine_extra_params = False
        options.mapper.abs_pose_refine_focal_length = options.mapper.abs_pose_refine_extra_params = False
    return options
