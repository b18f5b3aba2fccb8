"""Poses of frames between those that structure from motion used."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from e4dgs.vision.sfm.alignment import camera_centres
from e4dgs.vision.sfm.between.pose_between import pose_between
from e4dgs.vision.sfm.between.resect import resect
from e4dgs.vision.sfm.pairs import MOST_KEYS, key_frames
from scipy.spatial.transform import Rotation

WIDTH, HEIGHT = 320, 240
K = np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]])
BENT = np.array([-0.1, 0.02, 0.0, 0.0])


def pose(x: float, turn: float) -> np.ndarray:
    """A camera at height zero, ``x`` to the right, turned by ``turn`` degrees about its vertical axis."""
    result = np.eye(4)
    result[:3, :3] = Rotation.from_rotvec([0.2 * np.radians(turn), np.radians(turn), 0]).as_matrix()
    result[:3, 3] = -result[:3, :3] @ [x, 0.3 * x, 0]
    return result


# A camera that shakes, so that no frame lies where its neighbours make expect.
PATH = np.stack([pose(x, turn) for x, turn in [(0, 0), (0.03, 0.5), (0.1, -0.4), (0.11, 0.9), (0.2, 0.2), (0.26, 1.0)]])


def plane_points(places: np.ndarray, cam_from_world: np.ndarray) -> np.ndarray:
    """Where the rays through ``places`` [N, 2] px of a pinhole camera meet the slanted plane z = 4 + x / 2, [N, 3]."""
    rays = np.concatenate([(places - K[:2, 2]) / K[[0, 1], [0, 1]], np.ones((len(places), 1))], 1) @ cam_from_world[:3, :3]
    centre = camera_centres(cam_from_world[None])[0]
    along = (4 + 0.5 * centre[0] - centre[2]) / (rays[:, 2] - 0.5 * rays[:, 0])
    return np.asarray(centre + along[:, None] * rays)


def picture(cam_from_world: np.ndarray, walker: float) -> np.ndarray:
    """The plane's texture in a lens with distortion, and a textured square that is ``walker`` px to the right."""
    rng = np.random.default_rng(0)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (600, 800)).astype(np.float32), (0, 0), 2.0)
    texture = cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX)
    pixels = np.stack(np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5), -1).reshape(-1, 2)
    straight = cv2.undistortPoints(pixels[:, None], K, BENT, P=K)[:, 0]
    where = plane_points(straight, cam_from_world).reshape(HEIGHT, WIDTH, 3).astype(np.float32)
    shown = cv2.remap(texture, 400 + 110 * where[..., 0], 300 + 110 * where[..., 1], cv2.INTER_LINEAR)
    left = round(60 + walker)
    shown[90:150, left : left + 60] = texture[:60, :60]
    return np.repeat(np.clip(shown, 0, 255).astype(np.uint8)[..., None], 3, 2)


def solved(frames: np.ndarray, registered: list[bool], path: np.ndarray = PATH) -> tuple[dict[str, np.ndarray], list[np.ndarray]]:
    """What structure from motion would give for ``frames`` of the path, and the pictures of all."""
    pictures = [picture(one, 9.0 * i) for i, one in enumerate(path)]
    places, points, owner = [], [], []
    for k, i in enumerate(frames):
        found = cv2.goodFeaturesToTrack(pictures[i][..., 0], 200, 0.01, 4)
        assert found is not None
        xy = found[:, 0].astype(np.float64) + 0.5
        places.append(xy)
        points.append(plane_points(cv2.undistortPoints(xy[:, None], K, BENT, P=K)[:, 0], path[i]))
        owner.append(np.full(len(xy), k))
    known, n = np.array(registered), len(frames)
    return {
        "registered": known,
        "K": np.where(known[:, None, None], K, np.nan),
        "cam_from_world": np.where(known[:, None, None], path[frames], np.nan),
        "distortion": np.where(known[:, None], BENT, 0.0),
        "size": np.where(known[:, None], [WIDTH, HEIGHT], 0),
        "explained": np.ones(n),
        "points": np.concatenate(points),
        "tracks": np.ones(sum(map(len, points)), np.int64),
        "track_frame": np.concatenate(owner).astype(np.int32),
        "track_xy": np.concatenate(places).astype(np.float32),
        "seen": np.concatenate(owner).astype(np.int32),
    }, pictures


def test_a_shake_out_and_back_between_two_frames_is_followed() -> None:
    shaken = np.stack([pose(x, turn) for x, turn in [(0, 0), (0.08, 0.6), (0, 0), (0.05, 0.3), (0.1, 0)]])
    frames = np.array([0, 2, 4])
    arrays, pictures = solved(frames, [True, True, True], shaken)
    whole = pose_between(frames, arrays, len(shaken), pictures.__getitem__, lambda: None)
    off = np.linalg.norm(camera_centres(whole["cam_from_world"]) - camera_centres(shaken), axis=1)
    assert off.max() < 0.01


def test_frames_between_and_after_are_posed_by_the_points_in_them() -> None:
    frames, ticks = np.array([0, 4]), []
    arrays, pictures = solved(frames, [True, True])
    whole = pose_between(frames, arrays, len(PATH), pictures.__getitem__, lambda: ticks.append(1))
    assert whole["registered"].all() and len(ticks) == 4
    turned = whole["cam_from_world"][:, :3, :3] @ PATH[:, :3, :3].transpose(0, 2, 1)
    degrees = np.degrees(np.linalg.norm(Rotation.from_matrix(turned).as_rotvec(), axis=1))
    off = np.linalg.norm(camera_centres(whole["cam_from_world"]) - camera_centres(PATH), axis=1)
    assert degrees.max() < 0.05 and off.max() < 0.01  # expected poses are wrong by up to 1 degree and 0.06 units
    np.testing.assert_array_equal(whole["cam_from_world"][frames], PATH[frames])
    np.testing.assert_array_equal(whole["K"][2], K)
    np.testing.assert_array_equal(np.unique(whole["seen"]), frames)
    assert np.isnan(whole["explained"][[1, 2, 3, 5]]).all()


def test_a_picture_of_something_else_gets_no_pose() -> None:
    frames = np.array([0, 4])
    arrays, pictures = solved(frames, [True, True])
    pictures[2] = np.random.default_rng(1).integers(0, 255, pictures[2].shape).astype(np.uint8)
    whole = pose_between(frames, arrays, len(PATH), pictures.__getitem__, lambda: None)
    np.testing.assert_array_equal(whole["registered"], [True, True, False, True, True, True])
    assert np.isnan(whole["cam_from_world"][2]).all()


def test_frames_beside_one_without_a_pose_get_none() -> None:
    frames = np.array([0, 2, 4])
    arrays, pictures = solved(frames, [True, True, False])
    whole = pose_between(frames, arrays, len(PATH), pictures.__getitem__, lambda: None)
    np.testing.assert_array_equal(whole["registered"], [True, True, True, False, False, False])


def test_a_third_of_wrong_points_does_not_move_the_camera() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform([-2, -2, 3], [2, 2, 6], (200, 3))
    local = points @ PATH[3, :3, :3].T + PATH[3, :3, 3]
    seen = local[:, :2] / local[:, 2:]
    seen[:66] += rng.normal(0, 0.1, (66, 2))
    found, errors = resect(points, seen, PATH[2], 1e-3, 1.0)
    np.testing.assert_allclose(found, PATH[3], atol=1e-4)
    assert np.median(errors[66:]) < 1e-4 < errors[:66].min()


def test_far_points_leave_the_centre_where_it_was_expected() -> None:
    points = np.random.default_rng(0).uniform([-2e6, -2e6, 3e6], [2e6, 2e6, 6e6], (100, 3))
    local = points @ PATH[3, :3, :3].T
    found, _ = resect(points, local[:, :2] / local[:, 2:], PATH[2], 1e-3, 0.1)
    np.testing.assert_allclose(found[:3, :3], PATH[3, :3, :3], atol=1e-5)
    np.testing.assert_allclose(camera_centres(found[None]), camera_centres(PATH[2:3]), atol=1e-3)


@pytest.mark.parametrize(("images", "step"), [(90, 1), (MOST_KEYS, 1), (MOST_KEYS + 1, 2), (600, 3), (1500, 8)])
def test_long_sequences_are_thinned_for_structure_from_motion(images: int, step: int) -> None:
    np.testing.assert_array_equal(key_frames(images), np.arange(0, images, step))
