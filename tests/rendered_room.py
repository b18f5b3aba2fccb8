"""Cameras in an arc in a textured room with a box and a ball, rendered with their truth, as `Views`."""

import numpy as np
from e4dgs.scene.views import Views
from factory import Options, make, render

WIDTH, HEIGHT = 240, 180


def rendered_room(cameras):
    """Views of one time, their pictures, uint8 [H, W, 3], and the truth (depth, object) of each."""
    made = make(Options(rig="arc", backdrop="room", cameras=cameras, times=1, width=WIDTH, height=HEIGHT, samples=2, fov_degrees=60))
    truths = [render(made.scene, view.camera, view.time, samples=1) for view in made.views]
    pictures = [(truth.image[..., :3] * truth.image[..., 3:] * 255).astype(np.uint8) for truth in truths]
    n = len(made.views)
    views = Views(
        np.array([v.camera.K for v in made.views]), np.array([v.camera.cam_from_world for v in made.views]), np.zeros(n), np.arange(n),
        np.full(n, -1), np.arange(n), WIDTH, HEIGHT, lambda i: pictures[i],
    )  # fmt: skip
    return views, pictures, truths
