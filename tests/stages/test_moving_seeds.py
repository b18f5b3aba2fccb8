"""Seeds on what moves: on it at each time, and as fast as it goes."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from e4dgs.scene.seeds.moving.hull import VisualHull, _on_surface
from e4dgs.stages.seeds import key_times as usual
from e4dgs.stages.seeds import moving
from e4dgs.stages.seeds.depths import ANYWHERE
from e4dgs.stages.seeds.key_times import (
    APART,
    APART_ALONE,
    KEYS,
    LEAST_AT_ONCE,
    WAY,
    WAY_ALONE,
    apart_by_speed,
    key_times,
    rig_times,
    speed,
)
from e4dgs.stages.seeds.moving import HULL, MEASURED_SHARE, camera_seeds, on_surfaces, own_speed, rig_seeds, slope
from e4dgs.vision.flow.chain import Chain
from e4dgs.vision.moving.followed_parts import follow_objects
from moving_square import CAMERA, FOCAL, FRAMES, NEAR, SQUARE, WALL, WIDTH, flow_of, pose, views, wall
from sliding_ball import CAMERAS, RADIUS, TIMES, place, sliding_ball


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    return sliding_ball(tmp_path_factory.mktemp("rig") / "flow")


def test_before_one_camera_seeds_lie_on_the_mask_and_move_with_it(tmp_path):
    seeds = camera_seeds(flow_of(tmp_path / "flow"), views(), wall(), 125, 3000)
    assert seeds is not None and 1500 < len(seeds.points) <= 3000 * 1.5
    assert len(np.unique(seeds.time)) == FRAMES
    for k, t in enumerate(np.unique(seeds.time)):
        cam = seeds.points[seeds.time == t] + pose(k)[:3, 3]
        # The square is 40 px wide: its middle comes nearer by as much as it lies within the outline.
        assert cam[:, 2].max() == pytest.approx(ANYWHERE * WALL, rel=0.04)
        assert cam[:, 2].min() == pytest.approx(ANYWHERE * WALL * (1 - 20 / FOCAL), rel=0.02)
        assert np.allclose(seeds.colors[seeds.time == t], (10 * k + 5) / 255)
    # Farther away than the square is, the same flow is a longer way.
    scale = ANYWHERE * WALL * 0.9 / 4.0
    expected = CAMERA + scale * (SQUARE - CAMERA)
    assert np.median(seeds.velocities[:, 0]) == pytest.approx(expected, rel=0.1)
    assert np.abs(seeds.velocities[:, 1:]).max() < 0.1


def test_a_guessed_depth_is_not_held(tmp_path):
    seeds = camera_seeds(flow_of(tmp_path / "flow"), views(), wall(), 125, 3000)
    assert seeds is not None and not seeds.held


@pytest.mark.parametrize(("way", "times"), [(WAY_ALONE, FRAMES), (1.0, FRAMES // APART_ALONE)])
def test_before_one_camera_seeds_lie_closer_in_time_if_things_move_fast(way, times, tmp_path, monkeypatch):
    """The square moves by 3.6 % of the width from frame to frame."""
    monkeypatch.setattr(usual, "KEYS", 2)
    monkeypatch.setattr(moving, "WAY_ALONE", way)
    seeds = camera_seeds(flow_of(tmp_path / "flow"), views(), wall(), 125, 3000)
    assert seeds is not None and len(np.unique(seeds.time)) == times


def test_before_one_camera_the_more_times_have_seeds_the_more_there_are(tmp_path, monkeypatch):
    for module in (usual, moving):
        monkeypatch.setattr(module, "KEYS", 2)
    flow = flow_of(tmp_path / "flow")
    many, few = (camera_seeds(flow, views(), wall(), 100, most) for most in (3000, 200))
    assert many is not None and few is not None
    assert 0.6 * 100 * FRAMES < len(many.points) <= 1.2 * 100 * FRAMES and 0.6 * 200 < len(few.points) <= 1.2 * 200


def test_the_speed_of_what_moves_leaves_out_the_motion_of_the_camera(tmp_path):
    chain = Chain(flow_of(tmp_path / "flow"), list(range(FRAMES)))
    objects, depth = follow_objects(chain, FRAMES), 6.0
    depths = [np.where(number < 0, 0.0, depth).astype(np.float32) for number in objects.number]
    shown = FOCAL * ((SQUARE - CAMERA) / NEAR + CAMERA / depth)  # px a frame, at its outline
    measured = own_speed(chain, objects, depths, views(), list(range(FRAMES)), depth) * WIDTH
    assert measured == pytest.approx(abs(shown), rel=0.05)


def test_before_one_camera_nothing_hidden_means_no_seeds(tmp_path):
    assert camera_seeds(flow_of(tmp_path / "flow"), views(), np.zeros((0, 3)), 125, 3000) is None


def test_before_a_rig_seeds_lie_on_the_ball_at_each_time(rig):
    flow, seen, _ = rig
    seeds = rig_seeds(flow, seen, lambda i: flow.moving(i) > 127, np.arange(TIMES), 2000, 0)
    assert seeds is not None and len(np.unique(seeds.time)) == TIMES
    speed = 1.0 / (TIMES - 1)  # it slides by one unit over the capture
    for t in np.unique(seeds.time):
        row = seeds.time == t
        distance = np.linalg.norm(seeds.points[row] - place(t), axis=1)
        assert row.sum() > 100 and np.median(distance) < 1.6 * RADIUS  # the hull of few cameras is larger than the ball
        assert np.median(seeds.velocities[row, 0]) == pytest.approx(speed, rel=0.25)


@pytest.mark.parametrize("count", [1, 2])
def test_two_cameras_are_enough_for_seeds_and_one_is_not(rig, count):
    flow, seen, _ = rig
    few = replace(seen, train=seen.train[np.isin(seen.camera[seen.train], [1, CAMERAS - 1][:count])])
    seeds = rig_seeds(flow, few, lambda i: flow.moving(i) > 127, np.arange(TIMES), 2000, 0)
    if count == 1:
        assert seeds is None
        return
    assert seeds is not None and len(np.unique(seeds.time)) == TIMES
    distance = [np.linalg.norm(point - place(time)) for point, time in zip(seeds.points, seeds.time)]
    assert np.median(distance) < 1.6 * RADIUS
    for i in few.train:
        shown, x, y, _ = few.project(int(i), seeds.points[seeds.time == few.time[i]])
        assert len(shown) > 100 and (flow.moving(int(i))[y, x] > 127).mean() > 0.8  # some lie beside the outline, by less than a cell


def test_seeds_of_a_rig_do_not_depend_on_how_many_times_are_seeded_at_once(rig, monkeypatch):
    flow, seen, _ = rig
    found = []
    for at_once in (1, 4):
        monkeypatch.setattr(moving, "AT_ONCE", at_once)
        monkeypatch.setattr(torch, "get_num_threads", lambda: 4)
        found.append(rig_seeds(flow, seen, lambda i: flow.moving(i) > 127, np.arange(TIMES), 2000, 0))
    for one, several in zip(*found, strict=True):
        assert np.array_equal(one, several)


def test_before_a_rig_most_seeds_are_measured_and_the_rest_is_what_is_left_of_the_hull(rig, monkeypatch):
    flow, seen, _ = rig
    measured = np.full((5000, 3), 9.0)  # far from the hull

    def surface_points(views, frames, pictures, masks, hull):
        return measured, np.full((5000, 3), 0.25), np.arange(len(hull)) % 2 == 0

    def left(seeds):
        return np.sort(seeds[(seeds != 9).any(1)], axis=0)

    frames = seen.train[seen.time[seen.train] == seen.time[seen.train][0]]
    masks = [flow.moving(int(i)) > 127 for i in frames]
    monkeypatch.setattr(moving, "surface_points", surface_points)
    points, colors = on_surfaces(seen, VisualHull(seen), masks, frames, 1000, 0)
    assert (points == 9).all(1).sum() == round(MEASURED_SHARE * 1000) and (colors[(points == 9).all(1)] == 0.25).all()
    hull = VisualHull(seen).points(masks, frames, HULL, 0)[::2]
    assert len(left(points)) == min(400, len(hull)) and np.isin(left(points)[:, 0], hull[:, 0]).all()
    measured = measured[:10]
    monkeypatch.setattr(moving, "surface_points", lambda *given: (measured, measured, np.ones(len(given[-1]), bool)))
    points, _ = on_surfaces(seen, VisualHull(seen), masks, frames, 200, 0)
    assert len(points) == 200 and (points == 9).all(1).sum() == 10, "the hull stands for what is not measured"


def test_a_hull_that_has_seen_other_times_finds_the_same_points(rig):
    flow, seen, _ = rig
    used = VisualHull(seen)
    for time in np.unique(seen.time)[:3]:
        frames = seen.train[seen.time[seen.train] == time]
        masks = [flow.moving(int(i)) > 127 for i in frames]
        points = used.points(masks, frames, HULL, 0)
        assert len(points) > 100
        np.testing.assert_array_equal(points, VisualHull(seen).points(masks, frames, HULL, 0))


def test_cells_inside_a_solid_are_not_on_its_surface():
    axis = np.arange(20, 27)
    solid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    outside = ((solid == 20) | (solid == 26)).any(1)
    size, corner = 0.25, np.array([-3.0, 1.0, 2.0])
    np.testing.assert_array_equal(_on_surface(corner + (solid + 0.5) * size, corner, size), outside)


def test_before_a_rig_without_masks_there_are_no_seeds(rig):
    flow, seen, _ = rig
    assert rig_seeds(flow, seen, lambda i: None, np.arange(TIMES), 2000, 0) is None


@pytest.mark.parametrize(
    ("count", "expected"), [(1, 1), (KEYS, KEYS), (KEYS + 1, KEYS), (APART * KEYS, KEYS), (APART * KEYS + APART, KEYS + 1)]
)
def test_key_times_reach_from_first_to_last(count, expected):
    rows = key_times(np.linspace(0, 1, count), APART)
    assert len(rows) == expected and rows[0] == 0 and rows[-1] == count - 1


class Moving:
    """Flow of a band of ``width`` of 200 columns, at ``speed`` px a frame. The rest would move much more, but is not on the masks."""

    size, pairs = (10, 200), [(i, i + 1) for i in range(100)]

    def __init__(self, speed, width=40):
        self._speed, self._width = speed, width

    def moving(self, frame):
        mask = np.zeros(self.size, np.uint8)
        mask[:, : self._width] = 255
        return mask

    def forward(self, p):
        flow = np.full((*self.size, 2), 50.0, np.float16)
        flow[:, : self._width] = (0.6 * self._speed, 0.8 * self._speed)
        return flow


def test_key_times_of_a_rig_are_closer_if_things_move_fast():
    """At 200 px, moving pixels may move 2.8 px from one to the next."""
    times = np.linspace(0, 1, 300)
    counts = [len(rig_times(Moving(v), times, 100_000)) for v in (0.1, 0.35, 0.7, 1.4, 2.8, 10.0)]
    assert counts == pytest.approx([300 // APART, 300 // APART, 75, 150, 300, 300], abs=1)
    assert len(rig_times(Moving(1.0, width=0), times, 100_000)) == 300 // APART, "nothing moves"
    assert len(rig_times(Moving(10.0), times, 20_000)) == 20_000 // LEAST_AT_ONCE, "each time has seeds enough"
    assert len(rig_times(Moving(10.0), times, 10)) == len(rig_times(Moving(0.0), times[: KEYS + 5], 10)) == KEYS


@pytest.mark.parametrize(("speed_there", "expected"), [(0.0, 3.0), (WAY / 3, 3.0), (WAY / 2, 2.0), (WAY, 1.0), (1.0, 1.0)])
def test_key_times_are_so_close_that_nothing_gets_farther_than_its_way(speed_there, expected):
    assert apart_by_speed(3, WAY, speed_there) == pytest.approx(expected)


def test_the_speed_is_that_of_all_but_the_fastest_moving_pixels():
    assert speed(Moving(3.0)) == pytest.approx(3 / 200, rel=1e-3)


def test_a_slope_leaves_out_what_is_not_known():
    x = np.array([0.0, 1.0, 2.0, 3.0])
    y = np.stack([2 * x + 1, -x], 1)[..., None].repeat(3, 2)
    y[2] = 100.0
    known = np.array([[1, 1], [1, 0], [0, 0], [1, 0]], bool)
    assert np.allclose(slope(x, y, known), [[2.0] * 3, [0.0] * 3])
