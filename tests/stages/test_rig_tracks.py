"""Seeds on what moves before several cameras at once, carried along by exact flow."""

from dataclasses import replace

import numpy as np
import pytest
from e4dgs.scene.views import Views
from e4dgs.stages.rig_tracks import meet, rig_tracks
from factory import Cells, Motion, Object, Options, Sphere, make, optical_flow, render
from write_artifact import write_artifact

WIDTH, HEIGHT, TIMES, CAMERAS, RADIUS = 96, 72, 5, 6, 0.4


def place(t: float) -> np.ndarray:
    return np.array([-0.5 + t, 0.0, RADIUS])


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """A ball that slides by 1.25 of its diameter: flow artifact, views of the training cameras, seeds on its front at the middle time."""
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
        "movers": np.array([(truth.object == number) * 255 for truth in truths]).astype(np.uint8),
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
    return write_artifact(tmp_path_factory.mktemp("rig") / "flow", arrays), views, place(0.5) + RADIUS * normal


def test_seeds_go_where_the_ball_goes(rig):
    flow, views, seeds = rig
    tracks = rig_tracks(flow, views, seeds, np.full((len(seeds), 3), 0.5))
    times = np.unique(views.time)
    assert tracks is not None and np.allclose(tracks.times, times) and tracks.alive[len(times) // 2].all()
    for k, t in enumerate(times):
        assert tracks.alive[k].mean() > 0.6
        distance = np.linalg.norm(tracks.positions[k][tracks.alive[k]] - place(t), axis=1)
        assert np.median(np.abs(distance - RADIUS)) < 0.05


def test_without_cameras_or_seeds_nothing_is_followed(rig):
    flow, views, seeds = rig
    assert rig_tracks(flow, views, seeds[:0], seeds[:0]) is None
    one = views.train[views.camera == views.camera[0]]
    assert rig_tracks(flow, replace(views, train=one), seeds, seeds) is None


def test_rays_meet_though_one_of_them_is_wrong():
    rng = np.random.default_rng(0)
    centres, points = rng.normal(0, 4, (6, 3)), rng.normal(0, 0.3, (20, 3))
    rays = points[None] - centres[:, None]
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    rays[2] += [0.0, 0.2, 0.0]
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    seen = np.ones((6, 20), bool)
    seen[:, 0] = False
    seen[0, 0] = True
    found, agreed = meet(centres, rays, seen, points + 0.05, 0.005)
    assert agreed[1:].all() and not agreed[0]
    assert np.abs(found[1:] - points[1:]).max() < 0.01
