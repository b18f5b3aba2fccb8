"""Images -> cameras and points, by COLMAP's incremental or global mapper. Runs in the worker process: imports pycolmap."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from . import database as db
from .refine import refine

DATABASE = "database.db"  # in the request's folder
DEFAULT_FOCAL = 1.2  # of the longer side; COLMAP's habit for images without EXIF, refined by the bundle adjustment


def reconstruct(request: dict[str, Any], report: db.Report) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Reconstruct the images of `request`; the keys are those that `poses.py` writes.

    Returns arrays `registered` [n] bool, `K` [n,3,3], `cam_from_world` [n,4,4] (NaN where not registered), `distortion` [n,4]
    (k1 k2 p1 p2), `size` [n,2] (width, height of the file), `points` [P,3], `colors` [P,3] uint8, `errors` [P] px, `tracks` [P]
    (views of each point), `seen` [O] int32 and `seen_xy` [O,2] float32 px (image and place of every feature that made a point);
    and facts: `models` (images registered in each), `features` [n].
    """
    folder, root, names = Path(request["folder"]), Path(request["root"]), list(request["names"])
    seed = int(request["seed"])
    path = folder / DATABASE
    pycolmap.set_random_seed(seed)

    groups = list(request["cameras"])
    distinct = sorted(set(groups))
    cameras = [_camera(root / names[groups.index(g)], request) for g in distinct]
    ids = dict(zip(distinct, db.write_cameras(path, cameras), strict=True))
    db.extract(path, root, names, [ids[g] for g in groups], int(request["max_features"]), report)
    db.match(path, names, [(a, b) for a, b in request["pairs"]], seed, True, report)
    return map_database(path, request, report)


def map_database(path: Path, request: dict[str, Any], report: db.Report) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Cameras and points from the verified matches in a database; returns what `reconstruct` returns."""
    folder, root, names = Path(request["folder"]), Path(request["root"]), list(request["names"])
    models = _map(path, root, folder, request, report)
    with pycolmap.Database.open(path) as database:
        features = {image.name: database.num_keypoints_for_image(image.image_id) for image in database.read_all_images()}
    facts: dict[str, Any] = {
        "models": sorted((m.num_reg_images() for m in models), reverse=True),
        "features": [features.get(name, 0) for name in names],
    }
    largest = max(models, key=lambda m: (m.num_reg_images(), m.num_points3D()), default=None)
    if largest is not None:
        report("refining", 0, 1)
        refine(largest)
        report("refining", 1, 1)
    return _arrays(largest, names), facts


def _camera(image: Path, request: dict[str, Any]) -> pycolmap.Camera:
    """The camera before refinement: K of the capture, else the focal length in EXIF, else a guess."""
    guess = pycolmap.infer_camera_from_image(image)
    hint = request.get("K_hint")
    focal = guess.mean_focal_length() if guess.has_prior_focal_length else DEFAULT_FOCAL * max(guess.width, guess.height)
    if hint is not None:
        # the hint is for the output's size, the file may be larger
        focal = 0.5 * (hint[0][0] * guess.width / request["width"] + hint[1][1] * guess.height / request["height"])
    camera = pycolmap.Camera.create_from_model_name(0, request["camera_model"], focal, guess.width, guess.height)
    camera.has_prior_focal_length = hint is not None or guess.has_prior_focal_length
    if hint is not None:
        camera.principal_point_x = hint[0][2] * guess.width / request["width"]
        camera.principal_point_y = hint[1][2] * guess.height / request["height"]
    return camera


def _map(path: Path, root: Path, folder: Path, request: dict[str, Any], report: db.Report) -> list[pycolmap.Reconstruction]:
    out = folder / "models"
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
        return models

    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = int(request["seed"])
    options.num_threads = options.mapper.num_threads = 1
    # a full adjustment after a third more of frames or points: as accurate as after a tenth, and it is most of the time
    options.ba_global_frames_ratio = options.ba_global_points_ratio = 1.3
    options.ba_global_max_refinements = 3
    options.min_model_size = min(options.min_model_size, max(2, total // 2))
    registered = 0

    def advance() -> None:
        nonlocal registered
        registered += 1
        report("mapping", min(registered, total), total)

    for angle in request["init_angles"]:  # a camera that hardly moves has no pair at the usual first angle
        options.mapper.init_min_tri_angle = angle
        registered = 0
        models = list(pycolmap.incremental_mapping(path, root, out, options, next_image_callback=advance).values())
        if max((m.num_reg_images() for m in models), default=0) >= min(3, total):
            return models
    return models


def _arrays(model: pycolmap.Reconstruction | None, names: list[str]) -> dict[str, np.ndarray]:
    n = len(names)
    arrays = {
        "registered": np.zeros(n, bool),
        "K": np.full((n, 3, 3), np.nan),
        "cam_from_world": np.full((n, 4, 4), np.nan),
        "distortion": np.zeros((n, 4)),
        "size": np.zeros((n, 2), np.int64),
        "seen": np.zeros(0, np.int32),
        "seen_xy": np.zeros((0, 2), np.float32),
    }
    points = [] if model is None else list(model.points3D.values())
    arrays["points"] = np.array([p.xyz for p in points]).reshape(-1, 3)
    arrays["colors"] = np.array([p.color for p in points], np.uint8).reshape(-1, 3)
    arrays["errors"] = np.array([p.error for p in points], np.float64)
    arrays["tracks"] = np.array([p.track.length() for p in points], np.int64)
    if model is None:
        return arrays
    index = {name: i for i, name in enumerate(names)}
    seen, places = [arrays["seen"]], [arrays["seen_xy"]]
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        i, camera = index[image.name], model.camera(image.camera_id)
        arrays["registered"][i] = True
        arrays["K"][i] = camera.calibration_matrix()
        arrays["cam_from_world"][i] = np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])
        arrays["distortion"][i] = _distortion(camera)
        arrays["size"][i] = camera.width, camera.height
        places.append(np.array([p.xy for p in image.get_observation_points2D()], np.float32).reshape(-1, 2))
        seen.append(np.full(len(places[-1]), i, np.int32))
    arrays["seen"], arrays["seen_xy"] = np.concatenate(seen), np.concatenate(places)
    return arrays


def _distortion(camera: pycolmap.Camera) -> tuple[float, float, float, float]:
    """(k1, k2, p1, p2) of COLMAP's models that have no more than these."""
    extra = [float(camera.params[i]) for i in camera.extra_params_idxs()]
    k1, k2, p1, p2 = (*extra, 0.0, 0.0, 0.0, 0.0)[:4]
    return k1, k2, p1, p2
