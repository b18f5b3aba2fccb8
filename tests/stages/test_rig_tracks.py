"""Seeds on what moves before several cameras at once, carried along by exact flow."""

from dataclasses import replace

import numpy as np
import pytest
from e4dgs.stages.rig_tracks import meet, rig_tracks
from sliding_ball import RADIUS, place, sliding_ball


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    return sliding_ball(tmp_path_factory.mktemp("rig") / "flow")


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
