"""A ball that slides by 1.25 of its diameter before several cameras, with exact flow and masks."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from e4dgs.scene.views import Views
from e4dgs.stages.flow.artifact import StoredFlow
from factory import Cells, Motion, Object, Options, Sphere, make, optical_flow, render
from write_artifact import write_artifact

WIDTH, HEIGHT, TIMES, CAMERAS, RADIUS = 96, 72, 5, 6, 0.4


def place(t: float) -> np.ndarray:
    return np.array([-0.5 + t, 0.0, RADIUS])


def sliding_ball(folder: Path) -> tuple[StoredFlow, Views, np.ndarray]:
    """Flow, written to ``folder``, views of the training cameras, seeds on the ball's front at the middle time."""
    options = Options(rig="arc", cameras=CAMERAS, times=TIMES, boxes=0, spheres=0, width=WIDTH, height=HEIGHT, samples=1)
    made = make(options)
    ball = Object("ball", Sphere(RADIUS), Cells(0.3, 1), Motion(tuple(place(0.5)), slide=(1.0, 0.0, 0.0)))
    scene = replace(made.scene, objects=(*made.scene.objects, ball))
    chosen = [view for view in made.views if view.camera_index]
    truths = [render(scene, view.camera, view.time, samples=1) for view in chosen]
    number = len(scene.objects) - 1
    pairs = [(a, b) for a, one in enumerate(chosen) for b, two in enumerate(chosen)
             if one.camera_index == two.camera_index and two.time_index == one.time_index + 1]  # fmt: skip
    both = [[optical_flow(scene, chosen[a].camera, chosen[a].time, chosen[b].time).flow for a, b in order]
            for order in (pairs, [(b, a) for a, b in pairs])]  # fmt: skip
    arrays = {
        "pair": np.array(pairs, np.int32),
        "forward": np.array(both[0]).astype(np.float16),
        "backward": np.array(both[1]).astype(np.float16),
        "confidence": np.full((len(pairs), HEIGHT, WIDTH), 255, np.uint8),
        "moving": np.array([(truth.object == number) * 255 for truth in truths]).astype(np.uint8),
    }
    index = np.arange(len(chosen))
    views = Views(
        np.array([view.camera.K for view in chosen]), np.array([view.camera.cam_from_world for view in chosen]),
        np.array([view.time for view in chosen]), np.array([view.camera_index for view in chosen]), np.full(len(chosen), -1), index,
        WIDTH, HEIGHT, lambda i: np.zeros((HEIGHT, WIDTH, 3), np.uint8),
    )  # fmt: skip
    rng = np.random.default_rng(0)
    normal = rng.normal(size=(600, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal[normal @ (views.centres().mean(0) - place(0.5)) > 0.3]
    return StoredFlow(write_artifact(folder, arrays)), views, place(0.5) + RADIUS * normal
