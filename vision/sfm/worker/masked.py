"""The second pass: verifies and maps the first pass's features and matches again, without those on moving pixels. Runs in the worker
process: imports pycolmap."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from ....pipeline.files import written_beside
from ..masks import on_moving, static_matches
from .features import database as db
from .reconstruct import DATABASE, map_database

SAMPLE = 200_000  # matches used to compare the two passes; the share that agrees is then known to a tenth of a percent


def reconstruct_masked(request: dict[str, Any], report: db.Report) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Reconstructs without moving pixels. `request`: as for `reconstruct`, and `first` (folder of the first pass's database) and `masks`
    (npz file: `masks` [n,h,w] bool, `size` [n,2] px of the pictures).

    Returns the arrays of `reconstruct`, and `match_pair` [M,2] int32, `match_xy1`, `match_xy2` [M,2] float32 px: the matches off moving
    pixels, before verification, evenly thinned to `SAMPLE`. The facts are those of `reconstruct`, and `kept` and `matches`: the number of
    matches off moving pixels, and of all. A run that was killed resumes with its own database, which has no descriptors; the first pass's
    database is not changed.
    """
    names, pairs = list(request["names"]), [(int(a), int(b)) for a, b in request["pairs"]]
    path, seed = Path(request["folder"]) / DATABASE, int(request["seed"])
    pycolmap.set_random_seed(seed)
    if not path.exists():
        with np.load(request["masks"], allow_pickle=False) as file:
            masks, size = file["masks"], file["size"]
        with written_beside(path) as part:
            _copy(Path(request["first"]) / DATABASE, part, names, pairs, masks, size)
    sample = _sample(path, names, pairs)
    db.verify(path, names, pairs, seed, report)
    arrays, facts = map_database(path, request, report)
    with pycolmap.Database.open(Path(request["first"]) / DATABASE) as database:
        total = database.num_matches()
    with pycolmap.Database.open(path) as database:
        kept = database.num_matches()
    return {**arrays, **sample}, {**facts, "kept": kept, "matches": total}


def _copy(source: Path, target: Path, names: list[str], pairs: list[tuple[int, int]], masks: np.ndarray, size: np.ndarray) -> None:
    """Copies everything except descriptors, verified geometries, and matches on moving pixels."""
    ids = db.image_ids(source, names)
    with pycolmap.Database.open(source) as old, pycolmap.Database.open(target) as new, pycolmap.DatabaseTransaction(new):
        for camera in old.read_all_cameras():
            new.write_camera(camera, use_camera_id=True)
        for rig in old.read_all_rigs():
            new.write_rig(rig, use_rig_id=True)
        for frame in old.read_all_frames():
            new.write_frame(frame, use_frame_id=True)
        for image in old.read_all_images():
            new.write_image(image, use_image_id=True)
        moving = []
        for i, image_id in enumerate(ids):
            keypoints = np.asarray(old.read_keypoints(image_id), np.float32)
            new.write_keypoints(image_id, keypoints)
            moving.append(on_moving(masks, np.full(len(keypoints), i), keypoints[:, :2], size))
        for a, b in pairs:
            if old.exists_matches(ids[a], ids[b]):
                new.write_matches(ids[a], ids[b], static_matches(old.read_matches(ids[a], ids[b]), moving[a], moving[b]))


def _sample(path: Path, names: list[str], pairs: list[tuple[int, int]]) -> dict[str, np.ndarray]:
    ids = db.image_ids(path, names)
    pair, xy1, xy2 = [np.zeros((0, 2), np.int32)], [np.zeros((0, 2), np.float32)], [np.zeros((0, 2), np.float32)]
    with pycolmap.Database.open(path) as database:
        places = [np.asarray(database.read_keypoints(image_id), np.float32)[:, :2] for image_id in ids]
        step = max(1, -(-database.num_matches() // SAMPLE))
        for a, b in sorted(pairs):
            if database.exists_matches(ids[a], ids[b]):
                matches = database.read_matches(ids[a], ids[b])[::step]
                pair.append(np.full((len(matches), 2), (a, b), np.int32))
                xy1.append(places[a][matches[:, 0]])
                xy2.append(places[b][matches[:, 1]])
    return {"match_pair": np.concatenate(pair), "match_xy1": np.concatenate(xy1), "match_xy2": np.concatenate(xy2)}
