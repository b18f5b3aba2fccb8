"""`reconstruct_fixed`: cameras that stand still, one image each. Runs in the worker process: imports pycolmap.

With a few pictures from far apart, the mapper can start wrongly in many ways: a plane that fills the pictures (a wall, a floor) fits
several focal lengths and shapes, and no later picture tells them apart. So the mapper starts several times, at different focal lengths,
and the cameras that explain all matches best (`misfit`) are kept. On four cameras of a stage, single starts had an error of 0.03 to 50 %,
and the best of ten was always below 0.1 %.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pycolmap

from ..explains import Places, misfit
from ..impossible_points import purge
from .features import database as db
from .mapping import map_once
from .masked_points import without_moving_points
from .refine import lens_of, refine_or_keep
from .result import result_arrays
from .survey import survey

FOCALS = (1.0, 1.25, 0.8, 1.6, 0.6)  # of the longer side, the usual ones first: fields of view of 53, 44, 64, 35 and 80 degrees
ERRORS = (4.0, 2.0)  # px from the epipolar line allowed to a match; another limit makes RANSAC start differently, too
SAME = 0.02  # misfits this close belong to the same solution
AGREE = 3  # once this many starts reach the best solution, no more are tried
OWN = 0.1  # that the misfit must fall for each camera to get its own lens; four more numbers always fit a little better
PLANE = 0.95  # share of the matches that one homography must explain before the others are dropped
NO_LENS = 1.0  # added to the misfit if the lens is absurd


class Found(NamedTuple):
    misfit: float
    model: pycolmap.Reconstruction | None


def reconstruct_fixed(shared: Path, own: Path, request: dict[str, Any], report: db.Report) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """shared, own: databases with raw matches of the images of `request`; in `shared` all images have one lens, in `own` each has its own.
    Returns what `reconstruct` returns."""
    names = list(request["names"])
    matches = _places(shared, names, request["pairs"])
    best, tried = _best(shared, request, matches, report)
    notes = []
    if len(names) > 2:  # two pictures cannot determine two lenses
        alone = _start(own, request, matches, _focal(best), ERRORS[0], report)
        if alone.misfit < best.misfit - OWN:
            others, more = _best(own, request, matches, report)
            best, tried = min(best, alone, others, key=lambda found: found.misfit), tried + more
            notes.append("each camera gets its own lens: one for all explains the matches worse")
    found = survey(shared if best.model is None or len(best.model.cameras) == 1 else own, names, request["pairs"])
    facts: dict[str, Any] = {"features": found.features, "pairs": found.facts, "parts": [], "notes": notes, "turning": False}
    if best.model is None:
        return result_arrays(None, names), facts
    facts["parts"] = [best.model.num_reg_images()]
    notes.append(f"the mapper began {tried} times; the cameras that explain all matches best are kept")
    without_moving_points(best.model, request)
    return result_arrays(best.model, names), facts


def _best(path: Path, request: dict[str, Any], matches: Places, report: db.Report) -> tuple[Found, int]:
    """The best of several starts, and the number of starts."""
    found: list[Found] = []
    for error in ERRORS:
        for focal in FOCALS:
            found.append(_start(path, request, matches, focal, error, report))
            best = min(found, key=lambda one: one.misfit)
            if best.model is not None and sum(one.misfit < best.misfit + SAME for one in found) >= AGREE:
                return best, len(found)
    return min(found, key=lambda one: one.misfit), len(found)


def _start(path: Path, request: dict[str, Any], matches: Places, focal: float, error: float, report: db.Report) -> Found:
    """Verifies and maps the matches as if the focal length (of the longer side) were known, then refines it."""
    names, seed = list(request["names"]), int(request["seed"])
    with pycolmap.Database.open(path) as database:
        database.clear_two_view_geometries()
        for camera in database.read_all_cameras():
            params = np.array(camera.params)
            for k in camera.focal_length_idxs():
                params[k] = focal * max(camera.width, camera.height)
            camera.params = params.tolist()
            camera.has_prior_focal_length = True
            database.update_camera(camera)
    db.verify(path, names, request["pairs"], seed, report, error, PLANE)
    models = map_once(path, request, report, False)
    if not models:
        return Found(float("inf"), None)
    model = models[0]
    for camera_id in model.cameras:
        model.camera(camera_id).has_prior_focal_length = False  # it was only a guess, so the refined lens is judged
    purge(model)
    model, _, _ = refine_or_keep(model)
    strange = lens_of(model) is not None
    return Found(misfit(matches, result_arrays(model, names)) + (NO_LENS if strange else 0.0), model)


def _focal(found: Found) -> float:
    if found.model is None:
        return FOCALS[0]
    camera = found.model.camera(min(found.model.cameras))
    return float(camera.mean_focal_length() / max(camera.width, camera.height))


def _places(path: Path, names: list[str], pairs: list[list[int]]) -> dict[tuple[int, int], tuple[np.ndarray, np.ndarray]]:
    ids = db.image_ids(path, names)
    result = {}
    with pycolmap.Database.open(path) as database:
        places = [np.asarray(database.read_keypoints(i), np.float64)[:, :2] for i in ids]
        for a, b in pairs:
            if database.exists_matches(ids[a], ids[b]):
                rows = np.asarray(database.read_matches(ids[a], ids[b])).astype(np.int64)
                result[a, b] = places[a][rows[:, 0]], places[b][rows[:, 1]]
    return result
