"""Tours from camera to camera: through every stop, around the scene and never nearer to it than the nearest camera."""

import numpy as np
import pytest
from e4dgs.scene.camera_paths import centres, look_at
from e4dgs.stages.exports.camera_tours import separate, tour, travelled, turns

UP = np.array([0.0, 0, 1])
CENTRE = np.array([0.5, -0.2, 0.3])


def cameras(count: int, seed: int = 0) -> np.ndarray:
    """Cameras above the floor on all sides, at 3 to 5 units, that look past the centre and are a little rolled."""
    rng = np.random.default_rng(seed)
    bearing, height, radius = rng.uniform(0, 2 * np.pi, count), rng.uniform(0.05, 1.4, count), rng.uniform(3, 5, count)
    flat = radius * np.cos(height)
    eyes = CENTRE + np.stack([flat * np.cos(bearing), flat * np.sin(bearing), radius * np.sin(height)], 1)
    return np.stack([look_at(eye, CENTRE + rng.normal(0, 0.2, 3), UP + rng.normal(0, 0.1, 3)) for eye in eyes])


def facing(height: float, bearing: float) -> np.ndarray:
    eye = 4 * np.array([np.cos(height) * np.cos(bearing), np.cos(height) * np.sin(bearing), np.sin(height)])
    return look_at(CENTRE + eye, CENTRE, UP)


def test_a_tour_passes_its_stops_and_stays_between_their_distances_above_the_floor():
    poses = cameras(24)
    stops = poses[tour(poses, CENTRE, 12)]
    at = np.linspace(0, 11, 331)
    way = travelled(stops, at, CENTRE, UP)
    np.testing.assert_allclose(way[::30], stops, atol=1e-6)
    distances = np.linalg.norm(centres(way) - CENTRE, axis=1)
    own = np.linalg.norm(centres(stops) - CENTRE, axis=1)
    assert distances.min() >= own.min() - 1e-9 and distances.max() <= own.max() + 1e-9
    assert (centres(way)[:, 2] > CENTRE[2]).all(), "no camera is under the floor"
    seen = way[:, :3, :3] @ CENTRE + way[:, :3, 3]
    assert (np.linalg.norm(seen[:, :2], axis=1) < 0.35 * seen[:, 2]).all(), "the subject stays in the picture"
    steps = np.linalg.norm(np.diff(centres(way), axis=0), axis=1)
    assert steps.max() < 5 * np.pi / 30, "no jump"


def test_opposite_cameras_are_joined_around_the_scene():
    pair = np.stack([facing(0.3, 0.0), facing(0.3, np.pi)])
    way = travelled(pair, np.linspace(0, 1, 21), CENTRE, UP)
    np.testing.assert_allclose(np.linalg.norm(centres(way) - CENTRE, axis=1), 4.0)
    np.testing.assert_allclose(centres(way)[:, 2], CENTRE[2] + 4 * np.sin(0.3))


def test_a_camera_straight_above_is_a_stop_too():
    above = look_at(CENTRE + np.array([0.0, 0, 4]), CENTRE, np.array([0.0, 1, 0]))
    pair = np.stack([facing(0.2, 1.0), above])
    way = travelled(pair, np.linspace(0, 1, 9), CENTRE, UP)
    np.testing.assert_allclose(way[[0, -1]], pair, atol=1e-2)
    assert np.isfinite(way).all()


def test_near_cameras_are_joined_straight():
    pair = np.stack([facing(0.3, 0.0), facing(0.3, 0.1)])
    assert turns(pair)[0] < 10
    middle = travelled(pair, np.array([0.5]), CENTRE, UP)
    np.testing.assert_allclose(centres(middle)[0], centres(pair).mean(0))


def test_cameras_that_look_outwards_from_one_place_turn_without_leaving_it():
    eye = np.array([0.0, 0, 1])
    poses = np.stack([look_at(eye, eye + np.array([np.cos(a), np.sin(a), 0]), UP) for a in np.radians([0, 60, 120])])
    way = travelled(poses, np.linspace(0, 2, 9), eye + np.array([3.0, 0, 0]), UP)
    np.testing.assert_allclose(centres(way), np.tile(eye, (9, 1)), atol=1e-9)


@pytest.mark.parametrize("most", [2, 5, 24, 100])
def test_a_tour_begins_with_the_first_and_visits_each_once(most):
    order = tour(cameras(24), CENTRE, most)
    assert order[0] == 0 and len(order) == len(set(order.tolist())) == min(most, 24)


def test_a_tour_is_short():
    """Of cameras on a circle in a random order: once around, not to and fro."""
    bearings = np.random.default_rng(1).permutation(np.linspace(0, 2 * np.pi, 16, endpoint=False))
    poses = np.stack([facing(0.3, b) for b in bearings])
    eyes = centres(poses[tour(poses, CENTRE, 16)])
    steps = np.linalg.norm(np.diff(eyes, axis=0), axis=1)
    np.testing.assert_allclose(steps, steps[0])


def test_a_moving_camera_is_told_from_separate_ones():
    walk = np.stack([facing(0.3, 0.05 * k) for k in range(20)])
    assert not separate(walk) and separate(cameras(20)) and not separate(walk[:1])
