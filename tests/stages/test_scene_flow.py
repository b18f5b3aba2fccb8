"""Places on what moves before several cameras at once, carried along by exact flow."""

import numpy as np
import pytest
from e4dgs.stages.seeds.scene_flow import meet, next_positions
from e4dgs.vision.flow.chain import Chain
from e4dgs.vision.sequences import camera_sequences
from sliding_ball import RADIUS, place, sliding_ball


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    return sliding_ball(tmp_path_factory.mktemp("rig") / "flow")


def test_places_go_where_the_ball_goes(rig):
    flow, views, seeds = rig
    times = np.unique(views.time)
    chains = [(Chain(flow, frames), frames) for frames in camera_sequences(views.camera, views.time, views.train).values()]
    middle, everything = len(times) // 2, np.ones(len(seeds), bool)
    for direction in (1, -1):
        moved, known = next_positions(views, chains, middle, direction, seeds, everything)
        assert known.mean() > 0.6
        distance = np.linalg.norm(moved[known] - place(times[middle + direction]), axis=1)
        assert np.median(np.abs(distance - RADIUS)) < 0.03


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
