"""Exact optical flow between two times, from the surface point behind every pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .camera import Camera
from .render import Array, cast
from .scene import Scene


@dataclass(frozen=True)
class Flow:
    """flow [H,W,2] px (u right, v down) from the first view to the second, 0 where nothing is hit; visible [H,W]: the same
    surface point is in the second image and nothing stands before it; object [H,W] as in `Truth`."""

    flow: Array
    visible: NDArray[np.bool_]
    object: NDArray[np.int64]


def optical_flow(scene: Scene, camera: Camera, time: float, time_to: float, camera_to: Camera | None = None) -> Flow:
    """Flow of the pixel centres of `camera` at `time` to `camera_to` (the same one by default) at `time_to`."""
    target = camera if camera_to is None else camera_to
    pixels = camera.pixel_centres().reshape(-1, 2)
    origin, directions = camera.rays(pixels)
    hits = cast(scene, time, origin, directions)
    world = np.zeros_like(directions)
    for i, item in enumerate(scene.objects):
        chosen = hits.object == i
        pose = item.motion.world_from_object(time_to)
        world[chosen] = hits.local[chosen] @ pose[:3, :3].T + pose[:3, 3]

    landed, depth = target.project(world)
    found = (hits.object >= 0) & (depth > 1e-6)
    inside = (landed >= 0).all(axis=-1) & (landed[:, 0] <= target.width) & (landed[:, 1] <= target.height)
    # The ray towards the point itself: it is seen when nothing (not even its own object) is hit before it.
    first = cast(scene, time_to, target.centre, world - target.centre)
    visible = found & inside & (first.object == hits.object) & (np.abs(first.depth - 1.0) < 1e-6)
    flow = np.where(found[:, None], landed - pixels, 0.0)
    shape = (camera.height, camera.width)
    return Flow(flow.reshape(*shape, 2), visible.reshape(shape), hits.object.reshape(shape))
