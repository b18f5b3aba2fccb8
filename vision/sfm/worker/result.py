"""`result_arrays`: converts a reconstruction to the arrays that leave the worker process."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..impossible_points import angles, groups, observe
from .refine import distortion

if TYPE_CHECKING:
    import pycolmap


def result_arrays(model: pycolmap.Reconstruction | None, names: list[str]) -> dict[str, np.ndarray]:
    """The arrays that `reconstruct` describes. The model must be purged, so that every observation has a finite error."""
    n = len(names)
    arrays = {
        "registered": np.zeros(n, bool),
        "K": np.full((n, 3, 3), np.nan),
        "cam_from_world": np.full((n, 4, 4), np.nan),
        "distortion": np.zeros((n, 4)),
        "size": np.zeros((n, 2), np.int64),
        "points": np.zeros((0, 3)),
        "colors": np.zeros((0, 3), np.uint8),
        "seen": np.zeros(0, np.int32),
        "seen_xy": np.zeros((0, 2), np.float32),
        **{name: np.zeros(0) for name in ("errors", "angles", "residuals")},
        "tracks": np.zeros(0, np.int64),
        "track_frame": np.zeros(0, np.int32),
        "track_xy": np.zeros((0, 2), np.float32),
    }
    if model is None:
        return arrays
    index = {name: i for i, name in enumerate(names)}
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        i, camera = index[image.name], model.camera(image.camera_id)
        arrays["registered"][i] = True
        arrays["K"][i] = camera.calibration_matrix()
        arrays["cam_from_world"][i] = np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])
        arrays["distortion"][i] = distortion(camera)
        arrays["size"][i] = camera.width, camera.height
    seen = observe(model)
    starts, ends = groups(seen.point)
    if not len(starts):
        return arrays
    points = [model.point3D(int(k)) for k in seen.point[starts]]
    arrays["points"] = np.array([p.xyz for p in points])
    arrays["colors"] = np.array([p.color for p in points], np.uint8)
    arrays["tracks"] = ends - starts
    arrays["errors"] = np.add.reduceat(seen.error, starts) / (ends - starts)
    arrays["angles"] = angles(seen, np.ones(len(seen.error), bool))
    arrays["residuals"] = seen.error
    used = used_features(model, names)
    return {**arrays, **used, "track_frame": used["seen"], "track_xy": used["seen_xy"]}


def used_features(model: pycolmap.Reconstruction, names: list[str]) -> dict[str, np.ndarray]:
    """`seen` [O] int32 and `seen_xy` [O, 2] float32 px: frame and position of every feature that belongs to a point of the model."""
    index, seen = {name: i for i, name in enumerate(names)}, observe(model)
    frame_of = {i: index[model.image(i).name] for i in model.reg_image_ids()}
    return {"seen": np.array([frame_of[i] for i in seen.image], np.int32), "seen_xy": seen.xy.astype(np.float32)}
