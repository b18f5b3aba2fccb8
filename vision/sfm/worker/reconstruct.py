"""Cameras and points from images, by COLMAP's incremental or global mapper. Runs in the worker process: imports pycolmap."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from ..impossible_points import observe, purge
from ..pairs import MOST, STRONGEST, many
from ..pose_agreement import explained
from ..trouble import FIXED
from ..turning.result import turning_arrays
from ..turning.solve import ANYHOW
from .features import database as db
from .features.matching import match
from .features.strongest import extract_strongest
from .mapping import ENOUGH, map_images
from .masked_points import without_moving_points
from .reclaim import reclaim
from .refine import refine_or_keep
from .result import result_arrays, used_features
from .survey import free_pairs, survey, tell

DATABASE = "database.db"  # in the request's folder
DEFAULT_FOCAL = 1.2  # of the longer side; COLMAP's default for images without EXIF, refined by the bundle adjustment


def reconstruct(request: dict[str, Any], report: db.Report) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Reconstructs the images of `request`, whose keys are those that `stages/poses/solve.py` writes.

    Returns arrays `registered` [n] bool, `K` [n,3,3], `cam_from_world` [n,4,4] (NaN where not registered), `distortion` [n,4]
    (k1 k2 p1 p2), `size` [n,2] (width, height of the file), `points` [P,3], `colors` [P,3] uint8, `errors` [P] px, `tracks` [P]
    (views of each point), `angles` [P] degrees (between its outermost rays), `residuals` [R] px (reprojection error of every observation),
    `track_frame` [R] int32 and `track_xy` [R,2] float32 px (image and feature of every observation, in the order of the points),
    `seen` [O] int32 and `seen_xy` [O,2] float32 px (image and position of every feature that was adjusted), `explained` [n] (of
    `pose_agreement`; absent if the camera turns). None of them contains what no camera can have seen (`purge`). Facts: `parts` (disjoint,
    see `parts`), `features` [n], `pairs` (facts of `Survey`), `turning` (whether `turning/` found the cameras), `notes` (sentences about
    what was done).
    """
    folder, root, names = Path(request["folder"]), Path(request["root"]), list(request["names"])
    seed = int(request["seed"])
    path = folder / DATABASE
    pycolmap.set_random_seed(seed)

    groups = list(request["cameras"])
    distinct = sorted(set(groups))
    cameras = [first_camera(root / names[groups.index(g)], request) for g in distinct]
    ids = dict(zip(distinct, db.write_cameras(path, cameras), strict=True))
    of, most, keep = [ids[g] for g in groups], request["max_features"], request.get("keep")
    if many(len(names), bool(request["static"])):
        extract_strongest(path, root, names, of, most or STRONGEST, report, keep)
    else:
        octave = db.first_octave(root, names, cameras, bool(request["static"]))
        db.extract(path, root, names, of, most or MOST, report, keep, octave)
    match(path, names, [(a, b) for a, b in request["pairs"]], seed, True, report)
    return map_database(path, request, report)


def map_database(path: Path, request: dict[str, Any], report: db.Report) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Cameras and points from the verified matches in a database; returns what `reconstruct` returns."""
    arrays, facts = _map(path, request, report)
    if not facts["turning"]:
        arrays["explained"] = explained(free_pairs(path, request["names"], request["pairs"]), arrays)
    return arrays, facts


def _map(path: Path, request: dict[str, Any], report: db.Report) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    names = list(request["names"])
    found = survey(path, names, request["pairs"])
    facts: dict[str, Any] = {"features": found.features, "pairs": found.facts, "parts": [], "notes": [], "turning": False}
    if found.facts["verified"] and found.facts["shift"] < FIXED:
        return result_arrays(None, names), facts  # the mapper would search for a first pair for many minutes
    turned = turning_arrays(path, request, found, report)
    if turned is not None and turned[0]["registered"].sum() >= ENOUGH * len(names):
        return turned[0], {**facts, **turned[1]}
    models, fixed_lens, notes = map_images(path, request, report)
    if not models or models[0].num_reg_images() < ENOUGH * len(names):
        turned = turning_arrays(path, request, found, report, ANYHOW) or turned
    if turned is not None and (not models or models[0].num_reg_images() < turned[0]["registered"].sum()):
        return turned[0], {**facts, **turned[1]}
    if not models:
        return result_arrays(None, names), facts
    report("refining", 0, 1)
    largest, others = models[0], models[1:]
    observations = len(observe(largest).error)
    lost = purge(largest)
    merged: list[str] = []
    again: list[str] = []
    if largest.num_points3D() and largest.num_reg_images() < len(names):
        order = (
            {} if request["static"] else {name: (camera, i) for i, (name, camera) in enumerate(zip(names, request["cameras"], strict=True))}
        )
        largest, merged, again = reclaim(largest, others, path, order, fixed_lens, int(request["seed"]))
    # Moving objects bias the adjustment. So features on them are counted among all that it used, also those that do not fit afterwards.
    used = used_features(largest, names)
    largest, more, undone = refine_or_keep(largest, fixed_lens)
    report("refining", 1, 1)
    facts["notes"] = notes + tell(names, observations, [lost, more], undone, merged, again)
    facts["parts"] = parts([largest, *others])
    without_moving_points(largest, request)
    return {**result_arrays(largest, names), **used}, facts


def parts(models: list[pycolmap.Reconstruction]) -> list[int]:
    """Number of images in each model that are in none before it, without zeros. Disjoint, so they add up to all images with a pose."""
    seen: set[int] = set()
    sizes = []
    for model in models:
        new = set(model.reg_image_ids()) - seen
        seen |= new
        sizes.append(len(new))
    return sizes[:1] + sorted((size for size in sizes[1:] if size), reverse=True)


def first_camera(image: Path, request: dict[str, Any]) -> pycolmap.Camera:
    """The camera before refinement: from the capture's K, else with the focal length in EXIF, else a guess."""
    guess = pycolmap.infer_camera_from_image(image)
    hint = request.get("K_hint")
    focal = guess.mean_focal_length() if guess.has_prior_focal_length else DEFAULT_FOCAL * max(guess.width, guess.height)
    if hint is not None:
        # the hint refers to the output size; the file may be larger
        focal = 0.5 * (hint[0][0] * guess.width / request["width"] + hint[1][1] * guess.height / request["height"])
    camera = pycolmap.Camera.create_from_model_name(0, request["camera_model"], focal, guess.width, guess.height)
    camera.has_prior_focal_length = hint is not None or guess.has_prior_focal_length
    if hint is not None:
        camera.principal_point_x = hint[0][2] * guess.width / request["width"]
        camera.principal_point_y = hint[1][2] * guess.height / request["height"]
    return camera
