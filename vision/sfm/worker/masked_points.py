"""`without_moving_points`: removes points on moving pixels. Runs in the worker process: imports pycolmap."""

from __future__ import annotations

from typing import Any

import numpy as np
import pycolmap

from ..impossible_points import observe
from ..masks import on_moving

ENOUGH = 50  # points that must be left; with fewer, all stay


def without_moving_points(model: pycolmap.Reconstruction, request: dict[str, Any]) -> None:
    """Removes, in place, points that some image saw on moving pixels: matched at several times, such points are in several places.

    request: `masks`, npz file with `masks` [n, h, w] bool of the images `names` (False for images whose camera moved); without it nothing
    is done.
    """
    if not request.get("masks"):
        return
    with np.load(request["masks"], allow_pickle=False) as file:
        masks = file["masks"]
    index = {name: i for i, name in enumerate(request["names"])}
    frame_of = {i: index[model.image(i).name] for i in model.reg_image_ids()}
    size = np.zeros((len(masks), 2))
    for i, frame in frame_of.items():
        camera = model.camera(model.image(i).camera_id)
        size[frame] = camera.width, camera.height
    seen = observe(model)
    moving = on_moving(masks, np.array([frame_of[i] for i in seen.image], np.int64), seen.xy, size)
    gone = np.unique(seen.point[moving])
    if len(np.unique(seen.point)) - len(gone) < ENOUGH:
        return
    for point in gone:
        model.delete_point3D(int(point))
