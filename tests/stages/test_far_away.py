"""Captures far from the origin."""

import json
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
from e4dgs.scene.formats.axes import Turn
from e4dgs.stages.captures import recognise
from e4dgs.stages.captures.assembly.far_away import FAR, brought_near, told_moved
from e4dgs.stages.exports.splats import origin_of
from e4dgs.workflows.exports.camera_path import path_of_file
from e4dgs.workflows.exports.trained import axes_line
from scipy.spatial.transform import Rotation


def cameras(offset: float) -> np.ndarray:
    """Four turned cameras within 2 units of (offset, 0, 0)."""
    poses = np.tile(np.eye(4), (4, 1, 1))
    for pose, angle in zip(poses, np.linspace(0, 2 * np.pi, 4, endpoint=False)):
        c, s = np.cos(angle), np.sin(angle)
        pose[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
        pose[:3, 3] = -pose[:3, :3] @ [offset + 2 * c, 2 * s, 0.0]
    return poses


@pytest.mark.parametrize(("offset", "moved"), [(0.0, False), (1.99 * FAR, False), (2.01 * FAR, True), (4e6, True)])
def test_cameras_far_from_the_origin_are_moved_to_it(offset, moved):
    points = np.array([[offset, 0.0, 1.0]])
    placed = brought_near(list(cameras(offset)), points)
    assert (placed.origin is not None) == moved
    near = cameras(0.0 if moved else offset)
    np.testing.assert_allclose(placed.poses, near, atol=2 + 1e-8 if moved else 0)  # the origin is a round number
    np.testing.assert_allclose(placed.points, [[0.0, 0.0, 1.0]] if moved else points, atol=2)


@pytest.mark.parametrize("side", [60.0, 700.0, 3000.0])
def test_single_precision_is_enough_for_a_site_in_utm(side):
    """Cameras 100 m above a square site see a point below each to a tenth of a pixel, at 900 px of focal length."""
    rows, corner = np.linspace(0, side, 5), np.array([512_345.6, 5_412_345.6, 0.0])
    ground = corner + np.array([[x, y, 240.0] for x in rows for y in rows])
    poses = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (len(ground), 1, 1))
    poses[:, :3, 3] = -np.einsum("fij,fj->fi", poses[:, :3, :3], ground + np.array([7.3, -4.1, 100.0]))
    seen = np.einsum("fij,fj->fi", poses[:, :3, :3], ground) + poses[:, :3, 3]
    placed = brought_near(list(poses), ground)
    turn, shift, points = (a.astype(np.float32) for a in (placed.poses[:, :3, :3], placed.poses[:, :3, 3], placed.points))
    found = np.einsum("fij,fj->fi", turn, points) + shift
    assert np.abs(900 * (found[:, :2] / found[:, 2:] - seen[:, :2] / seen[:, 2:])).max() < 0.1


def test_a_small_scene_is_moved_in_its_own_units():
    poses = cameras(0.0)
    poses[:, :3, 3] *= 1e-6
    poses[:, :3, 3] -= poses[:, :3, :3] @ [0.03, 0.0, 0.0]
    placed = brought_near(list(poses), None)
    centres = -np.einsum("fji,fj->fi", placed.poses[:, :3, :3], placed.poses[:, :3, 3])
    assert placed.points is None and np.abs(centres).max() < 4e-6


@pytest.mark.parametrize("frames", [1, 7, 49])
def test_a_single_place_says_nothing_about_how_large_the_scene_is(frames):
    """The mean of equal numbers differs from them by rounding."""
    pose = np.eye(4)
    pose[:3, 3] = [-0.1, -0.2, -0.3]
    assert brought_near([pose] * frames, None).origin is None


def test_a_camera_that_hardly_moves_is_as_far_as_its_points_say():
    poses = cameras(0.0)
    poses[:, :3, 3] *= 1e-5
    poses[:, :3, 3] -= poses[:, :3, :3] @ [4.0, 0.0, 0.0]
    assert brought_near(list(poses), None).origin is not None
    assert brought_near(list(poses), np.array([[4.0, 0.0, 3.0]] * 3)).origin is None
    assert brought_near(list(poses), np.array([[4.0, 0.0, 1e-5]] * 3)).origin is not None


def test_poses_that_some_frames_lack_are_left_out():
    assert brought_near([np.eye(4), None], None) == (None, None, None)


@pytest.fixture
def far(nerfstudio_capture, tmp_path):
    """A capture whose cameras are some 4e6 units from the origin."""
    root = shutil.copytree(nerfstudio_capture.root, tmp_path / "utm")
    data = json.loads((root / "transforms.json").read_text())
    for frame in data["frames"]:
        for row, shift in zip(frame["transform_matrix"], (500_000.0, 4_000_000.0, 250.0)):
            row[3] += shift
    (root / "transforms.json").write_text(json.dumps(data))
    return root


def test_a_far_capture_is_the_near_one_about_another_origin(nerfstudio_capture, far):
    near, capture = recognise(nerfstudio_capture.root), recognise(far)
    assert near.origin is None and capture.origin is not None
    shift = np.array([500_000.0, 4_000_000.0, 250.0]) - capture.origin
    expected = near.cam_from_world.copy()
    expected[:, :3, 3] -= expected[:, :3, :3] @ shift
    np.testing.assert_allclose(capture.cam_from_world, expected, atol=1e-8)
    assert told_moved(capture.origin) in capture.notes


def test_exports_say_where_a_far_capture_was(far):
    capture = recognise(far)
    moved, where = SimpleNamespace(origin=capture.origin), ", ".join(f"{x:.9g}" for x in capture.origin)
    assert f"0 0 0 is the point ({where}) of the capture's files" in axes_line(Turn("Z", "Y"), moved)
    assert origin_of(moved) == {"origin": capture.origin.tolist()}
    near = SimpleNamespace(origin=None)
    assert axes_line(Turn("Y", "Y"), near) == "axes: up is Y, and all axes are those of the capture" and origin_of(near) == {}


def test_a_path_file_is_in_the_world_of_the_far_captures_files(far, tmp_path):
    capture, path = recognise(far), tmp_path / "path.json"
    row = json.loads((far / "transforms.json").read_text())["frames"][0]
    path.write_text(json.dumps({"frames": [{"transform_matrix": row["transform_matrix"]}]}))
    frames = SimpleNamespace(K=capture.K, train=np.array([0]), origin=capture.origin, width=64, height=64)
    found = path_of_file(path, frames).cam_from_world[0]
    assert np.abs(capture.cam_from_world - found).max(axis=(1, 2)).min() < 1e-6


def test_points_are_moved_with_the_cameras(colmap_capture, tmp_path):
    root, near = shutil.copytree(colmap_capture.root, tmp_path / "colmap"), recognise(colmap_capture.root)
    shift = np.array([500_000.0, 4_000_000.0, 250.0])

    def rewrite(name, first, change):
        """Adds ``change(row)`` to three columns of the rows that have them, from column ``first``."""
        file = root / "sparse" / "0" / name
        rows = [line.split() for line in file.read_text().splitlines()]
        for row in rows:
            if len(row) > 7 and row[0] != "#":
                row[first : first + 3] = [f"{float(x) + d:.17g}" for x, d in zip(row[first : first + 3], change(row))]
        file.write_text("\n".join(map(" ".join, rows)) + "\n")

    rewrite("points3D.txt", 1, lambda row: shift)
    rewrite("images.txt", 5, lambda row: -Rotation.from_quat([float(x) for x in (*row[2:5], row[1])]).apply(shift))
    capture = recognise(root)
    np.testing.assert_allclose(capture.points + capture.origin, near.points + shift, atol=1e-6)
    turned = capture.cam_from_world[:, :3, :3] @ (shift - capture.origin)
    np.testing.assert_allclose(capture.cam_from_world[:, :3, 3] + turned, near.cam_from_world[:, :3, 3], atol=1e-6)
