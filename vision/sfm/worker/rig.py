"""Structure from motion of several cameras, some of which stand still. Runs in the worker process: imports pycolmap.

The features of all pictures that a camera took from one place are merged into one image (`looks.py`). The camera then has a single pose,
moving objects help to find it, and a feature that is found several times counts with its mean error.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from ....pipeline.files import written_beside
from ..pairs import MOST
from .features import database as db
from .features.matching import match
from .reconstruct import DATABASE, first_camera, map_database
from .starts import reconstruct_fixed

LOOKS = "looks.db"  # features and raw matches of all pictures, in the request's folder


def reconstruct_rig(request: dict[str, Any], report: db.Report) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """`request`: as for `reconstruct`, but `names` and `pairs` are of the pictures used. `images` [L]: the image that each belongs to;
    `cameras` [n]: the camera of each image; `all_fixed`: whether each camera has one image; `masks`: npz file, see `without_moving_points`.

    Returns what `reconstruct` returns, for the n images.
    """
    folder, root, names = Path(request["folder"]), Path(request["root"]), list(request["names"])
    image, seed = [int(i) for i in request["images"]], int(request["seed"])
    pairs = [(int(a), int(b)) for a, b in request["pairs"]]
    pycolmap.set_random_seed(seed)
    looks = folder / LOOKS
    camera_ids = db.write_cameras(looks, [first_camera(root / names[0], request)]) * len(names)
    db.extract(looks, root, names, camera_ids, request["max_features"] or MOST, report)
    match(looks, names, pairs, seed, False, report)

    firsts = [names[image.index(i)] for i in range(max(image) + 1)]
    joined = sorted({(image[a], image[b]) for a, b in pairs})
    groups = [int(c) for c in request["cameras"]]
    below = {**request, "names": firsts, "pairs": joined, "cameras": groups}

    def merged(lenses: Sequence[int], name: str) -> Path:
        path = folder / name
        if not path.exists():
            cameras = [first_camera(root / firsts[lenses.index(k)], request) for k in sorted(set(lenses))]
            with written_beside(path) as part:
                merge(looks, part, names, image, pairs, cameras, lenses)
        return path

    if request["all_fixed"]:
        return reconstruct_fixed(merged([0] * len(firsts), "shared.db"), merged(groups, DATABASE), below, report)
    path = merged(groups, DATABASE)
    db.verify(path, firsts, joined, seed, report)
    return map_database(path, below, report)


def merge(
    source: Path,
    target: Path,
    names: Sequence[str],
    image: Sequence[int],
    pairs: Sequence[tuple[int, int]],
    cameras: Sequence[pycolmap.Camera],
    lenses: Sequence[int],
) -> None:
    """Writes a database whose images have the features of all their pictures, in order, with the raw matches between them.

    names [L], image [L]: pictures in `source`, and the image that each belongs to; an image takes the name of its first picture. pairs: of
    pictures that were matched. lenses [n]: the lens of each image; `cameras`: one for each lens, in rising order of lens.
    """
    ids = db.image_ids(source, names)
    order = {lens: k for k, lens in enumerate(sorted(set(lenses)))}
    with pycolmap.Database.open(source) as old, pycolmap.Database.open(target) as new, pycolmap.DatabaseTransaction(new):
        begins, features = [], [list[np.ndarray]() for _ in lenses]
        for picture, i in enumerate(image):
            begins.append(sum(map(len, features[i])))
            features[i].append(np.asarray(old.read_keypoints(ids[picture]), np.float32))
        camera_ids, rig_ids = [], []
        for camera in cameras:
            camera_ids.append(new.write_camera(camera))
            rig = pycolmap.Rig()
            rig.add_ref_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera_ids[-1]))
            rig_ids.append(new.write_rig(rig))
        image_ids = []
        for i, lens in enumerate(lenses):
            camera_id = camera_ids[order[lens]]
            image_ids.append(new.write_image(pycolmap.Image(name=names[list(image).index(i)], camera_id=camera_id)))
            frame = pycolmap.Frame()
            frame.rig_id = rig_ids[order[lens]]
            frame.add_data_id(pycolmap.data_t(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera_id), image_ids[-1]))
            new.write_frame(frame)
            new.write_keypoints(image_ids[-1], np.concatenate(features[i]))
        matches: dict[tuple[int, int], list[np.ndarray]] = {}
        for a, b in pairs:
            if image[a] != image[b] and old.exists_matches(ids[a], ids[b]):
                found = np.asarray(old.read_matches(ids[a], ids[b])).astype(np.int64)
                matches.setdefault((image[a], image[b]), []).append(found + np.array([begins[a], begins[b]]))
        for (a, b), parts in sorted(matches.items()):
            new.write_matches(image_ids[a], image_ids[b], np.concatenate(parts).astype(np.uint32))
