"""Camera paths: they look where they should, stay where the cameras were, and close."""

import numpy as np
import pytest
from e4dgs.scene.camera_paths import along, centres, look_at, spiral, turntable, upward

UP = np.array([0.0, 0, 1])
TARGET = np.array([0.5, -0.2, 0.3])


def ring(count: int = 12, radius: float = 4.0, height: float = 1.5) -> np.ndarray:
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    eyes = TARGET + np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(count, height)], 1)
    return np.stack([look_at(eye, TARGET, UP) for eye in eyes])


def in_the_middle(poses: np.ndarray) -> bool:
    seen = poses[:, :3, :3] @ TARGET + poses[:, :3, 3]
    return bool(np.allclose(seen[:, :2], 0, atol=1e-9) and (seen[:, 2] > 0).all())


def test_look_at_is_an_opencv_camera_with_its_target_ahead_and_up_upwards():
    pose = look_at(np.array([0.0, -5, 0]), np.zeros(3), UP)
    np.testing.assert_allclose(pose[:3, :3], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-12)
    np.testing.assert_allclose(pose @ [0, 0, 0, 1], [0, 0, 5, 1])
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)


@pytest.mark.parametrize("eye", [np.zeros(3), np.array([0.0, 0, 2])])
def test_look_at_refuses_what_has_no_answer(eye):
    with pytest.raises(ValueError, match="look_at"):
        look_at(eye, np.zeros(3), UP)


def test_a_turntable_keeps_the_distance_and_height_of_the_cameras_and_closes():
    way = turntable(ring(), TARGET, 40)
    assert in_the_middle(way)
    offset = centres(way) - TARGET
    np.testing.assert_allclose(offset[:, 2], 1.5, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(offset[:, :2], axis=1), 4.0)
    steps = np.linalg.norm(np.diff(centres(way)[[*range(40), 0]], axis=0), axis=1)
    np.testing.assert_allclose(steps, steps[0])


@pytest.mark.parametrize(("missing", "circle"), [(2, True), (3, False)])
def test_a_turntable_swings_where_the_cameras_leave_a_gap(missing, circle):
    """Of a camera every 24 degrees, two missing ones leave 72 degrees open, three 96."""
    poses = ring(15)[missing:]
    way = turntable(poses, TARGET, 64)
    assert in_the_middle(way)
    offset = centres(way) - TARGET
    angles = np.degrees(np.arctan2(offset[:, 1], offset[:, 0])) % 360
    if circle:
        assert np.diff(np.sort(angles)).max() < 10
    else:
        assert angles.min() == pytest.approx(24 * missing, abs=0.5) and angles.max() == pytest.approx(336, abs=0.5)
        assert np.linalg.norm(offset[0] - offset[-1]) < np.linalg.norm(np.diff(offset, axis=0), axis=1).max() + 1e-9


def test_a_turntable_around_one_camera_straight_above_still_moves():
    above = look_at(TARGET + np.array([0.0, 0, 3]), TARGET, np.array([0.0, 1, 0]))[None]
    way = turntable(above, TARGET, 8)
    assert in_the_middle(way) and np.ptp(centres(way), axis=0).max() > 0.1


def test_a_spiral_stays_between_the_cameras_and_faces_the_target():
    few = ring(24)[:3]
    way = spiral(few, TARGET, 60)
    assert in_the_middle(way)
    eyes = centres(way) - centres(few)[1]
    assert np.linalg.norm(eyes, axis=1).max() < np.linalg.norm(centres(few)[0] - centres(few)[1])


def test_a_spiral_before_one_camera_moves_a_little():
    one = ring()[:1]
    way = spiral(one, TARGET, 60)
    distance = np.linalg.norm(centres(one)[0] - TARGET)
    reach = np.linalg.norm(centres(way) - centres(one), axis=1)
    assert 0.05 * distance < reach.max() < 0.2 * distance


def test_along_passes_through_every_pose():
    poses = ring(5)
    way = along(poses, 9)
    np.testing.assert_allclose(way[::2], poses, atol=1e-9)
    np.testing.assert_allclose(centres(way)[1], centres(poses)[:2].mean(0))
    np.testing.assert_allclose(along(poses[:1], 3), np.repeat(poses[:1], 3, axis=0))


def test_upward_is_what_the_cameras_hold_upwards():
    up = upward(ring(12))
    np.testing.assert_allclose(up, UP, atol=1e-9)


@pytest.mark.parametrize("roll", [0.0, 3.0])
def test_upward_does_not_follow_cameras_that_look_down_from_one_side(roll):
    """Ten cameras look steeply down from one side, two from the other: their mean up direction is 20 degrees off."""
    rng = np.random.default_rng(0)
    angles = [*rng.uniform(-1, 1, 10), 2.5, 3.5]
    eyes = TARGET + np.stack([3 * np.cos(angles), 3 * np.sin(angles), np.full(12, 3.0)], 1)
    rolled = [UP + np.tan(np.radians(rng.normal(0, roll))) * np.array([-np.sin(a), np.cos(a), 0]) for a in angles]
    poses = np.stack([look_at(eye, TARGET, up) for eye, up in zip(eyes, rolled)])
    mean = -poses[:, 1, :3].mean(0)
    assert np.degrees(np.arccos(mean[2] / np.linalg.norm(mean))) > 15
    assert np.degrees(np.arccos(upward(poses)[2])) < 1 + roll


def test_upward_of_cameras_side_by_side_is_their_own():
    """They say nothing about how far they are tilted."""
    poses = np.stack([look_at(np.array([x, -4.0, 3.0]), np.array([x, 0, 0.0]), UP) for x in (0.0, 1.0)])
    np.testing.assert_allclose(upward(poses), [0, 0.6, 0.8], atol=1e-9)


@pytest.mark.parametrize(("moved", "least", "most"), [(0.0, 0, 3.1), (1e-3, 11, 25)])
def test_a_path_hardly_leaves_the_place_of_one_camera_that_stands_still(moved, least, most):
    poses = np.stack([look_at(np.array([moved * k, -4.0, 1.0]), TARGET, UP) for k in range(5)])
    for path in (turntable, spiral):
        eyes = np.stack([-pose[:3, :3].T @ pose[:3, 3] for pose in path(poses, TARGET, 40)])
        rays = eyes - TARGET
        first = -poses[0, :3, :3].T @ poses[0, :3, 3] - TARGET
        angle = np.degrees(np.arccos(np.clip(rays @ first / np.linalg.norm(rays, axis=1) / np.linalg.norm(first), -1, 1)))
        assert angle.max() <= most and (path is spiral or angle.max() >= least)
