"""Cameras of several videos without poses: those that stand still are found, get one pose each, and lie where the truth has them."""

import json
import shutil

import numpy as np
import pytest
from e4dgs.stages.shared.frameset import FrameSet
from e4dgs.vision.sfm.alignment import camera_centres, similarity
from e4dgs.vision.sfm.explains import FARTHEST, NOISE, misfit
from e4dgs.vision.sfm.fixed_cameras import is_fixed
from e4dgs.vision.sfm.looks import MOST, choose_looks, expand, look_times
from factory import Options, make, render
from factory.render import to_uint8
from factory.writers import flatten, write_mp4
from pose_error import pose_error
from run_stage import run_poses

CAMERAS, TIMES = 5, 6


def rig_error(estimated, truth) -> float:
    """Largest distance of a camera from its true place after a similarity, in percent of the largest distance between two cameras."""
    found, true = camera_centres(estimated), camera_centres(truth)
    scale, R, t = similarity(found, true)
    size = np.linalg.norm(true[:, None] - true[None], axis=-1).max()
    return 100 * float(np.linalg.norm(scale * found @ R.T + t - true, axis=1).max() / size)


@pytest.fixture(scope="module")
def solved(videos_capture, tmp_path_factory):
    return run_poses(videos_capture.root, tmp_path_factory.mktemp("solved"))


@pytest.fixture(scope="module")
def truth(videos_capture) -> np.ndarray:
    return np.stack([view.camera.cam_from_world for view in videos_capture.views])


def test_cameras_of_videos_are_found_to_one_percent_of_the_rig(solved, truth):
    assert solved.artifact.read("registered").all()
    poses = solved.artifact.read("cam_from_world")[::TIMES]
    assert rig_error(poses, truth[::TIMES]) < 1.0
    assert pose_error(poses, truth[::TIMES])["rotation_degrees"] < 0.5


def test_a_camera_that_stands_still_has_one_pose_to_the_bit(solved):
    for name in ("K", "cam_from_world", "distortion"):
        array = solved.artifact.read(name).reshape(CAMERAS, TIMES, -1)
        assert (array == array[:, :1]).all(), name
    assert f"all of the {CAMERAS} cameras stand still: one pose each, from pictures at {TIMES} times" in solved.lines


def test_one_lens_serves_cameras_that_are_alike(solved, videos_capture):
    K = solved.artifact.read("K")
    assert (K[0] == K).all()
    assert K[0, 0, 0] == pytest.approx(videos_capture.views[0].camera.K[0, 0], rel=0.02)


def test_later_stages_see_a_rig_of_fixed_cameras(solved):
    frames = FrameSet(solved.context.inputs["frames"], solved.context.capture.root, solved.artifact)
    assert frames.fixed_cameras and not solved.context.facts["fixed_cameras"]
    assert len(frames.train) == CAMERAS * (TIMES - 1)


def test_points_are_static(solved, videos_capture):
    """Features on what moves helped the cameras, and are no points of the world: what moves is in another place at each time."""
    scale, R, t = similarity(
        camera_centres(solved.artifact.read("cam_from_world")[::TIMES]),
        camera_centres(np.stack([view.camera.cam_from_world for view in videos_capture.views])[::TIMES]),
    )
    points = scale * solved.artifact.read("points") @ R.T + t
    assert len(points) > 50
    # the room is 8 x 8 x 4 and what moves is in its middle; without masks of it 8 % of the points are
    inside = np.minimum(4 - np.abs(points[:, :2]).max(axis=1), np.minimum(points[:, 2], 4 - points[:, 2]))
    assert (inside < 0.3).mean() > 0.99, "on a wall, the floor or the ceiling"


def test_a_second_run_gives_the_same_bits(solved, videos_capture, tmp_path):
    again = run_poses(videos_capture.root, tmp_path)
    assert again.artifact.digest == solved.artifact.digest


def test_fixed_cameras_and_a_moving_one_come_into_one_world(videos_capture, truth, tmp_path):
    folder = tmp_path / "mixed"
    folder.mkdir()
    for name in ("a.mp4", "b.mp4", "e.mp4"):
        shutil.copy(videos_capture.root / name, folder / name)
    options = Options(backdrop="room", rig="path", times=TIMES, width=240, height=180, samples=2, fov_degrees=60.0)
    walk = make(options)
    write_mp4(folder / "z.mp4", (flatten(render(walk.scene, v.camera, v.time, options.samples)) for v in walk.views), options.fps)
    ran = run_poses(folder, tmp_path / "work")
    assert "of 4 cameras a.mp4, b.mp4, e.mp4 stand still: one pose each" in ran.lines
    poses = ran.artifact.read("cam_from_world")
    assert ran.artifact.read("registered").all()
    assert (poses[:TIMES] == poses[0]).all() and len(np.unique(poses[3 * TIMES :, 0, 3])) == TIMES
    chosen = np.concatenate([truth[[0, TIMES, 4 * TIMES]], np.stack([v.camera.cam_from_world for v in walk.views])])
    assert rig_error(poses[[0, TIMES, 2 * TIMES, *range(3 * TIMES, 4 * TIMES)]], chosen) < 1.0
    assert not FrameSet(ran.context.inputs["frames"], folder, ran.artifact).fixed_cameras


def test_cameras_of_two_kinds_get_a_lens_each(videos_capture, truth, tmp_path):
    folder = tmp_path / "two_kinds"
    shutil.copytree(videos_capture.root, folder)
    options = Options(backdrop="room", rig="arc", cameras=CAMERAS, times=TIMES, width=240, height=180, samples=2, fov_degrees=44.0)
    longer = make(options)
    for camera, name in ((2, "c.mp4"), (3, "d.mp4")):
        own = [v for v in longer.views if v.camera_index == camera]
        write_mp4(folder / name, (flatten(render(longer.scene, v.camera, v.time, options.samples)) for v in own), options.fps)
    ran = run_poses(folder, tmp_path / "work")
    assert any("each camera gets its own lens" in line for line in ran.lines)
    wide, long = videos_capture.views[0].camera.K[0, 0], longer.views[0].camera.K[0, 0]
    np.testing.assert_allclose(ran.artifact.read("K")[::TIMES, 0, 0], [wide, wide, long, long, wide], rtol=0.02)
    assert rig_error(ran.artifact.read("cam_from_world")[::TIMES], truth[::TIMES]) < 1.0


@pytest.fixture(scope="module")
def textured() -> np.ndarray:
    scene = make(Options(backdrop="room", rig="arc", cameras=1, times=1, width=320, height=240, samples=1, motion=0.0))
    return to_uint8(render(scene.scene, scene.views[0].camera, 0.0, 1).image)[..., :3]


def test_a_camera_before_which_something_walks_stands_still(textured):
    pictures = []
    for k in range(7):
        picture = textured.copy()
        picture[40:220, 20 + 30 * k : 120 + 30 * k] = np.random.default_rng(7).integers(0, 255, (180, 100, 3), np.uint8)
        pictures.append(picture)
    assert is_fixed(pictures.__getitem__, range(7))


def test_a_camera_that_drifts_by_a_pixel_does_not_stand_still(textured):
    import cv2

    def drifted(k: int) -> np.ndarray:
        return cv2.warpAffine(textured, np.array([[1.0, 0, k / 6], [0, 1, 0]]), (320, 240), borderMode=cv2.BORDER_REPLICATE)

    assert not is_fixed(drifted, range(7))


def test_plain_pictures_tell_nothing():
    assert not is_fixed(lambda k: np.full((120, 160, 3), 90, np.uint8), range(5))


def test_pictures_of_two_cameras_are_matched_at_equal_times_alone():
    camera, time = np.repeat([0, 1, 2], 12), np.tile(np.linspace(0, 1, 12), 3)
    looks = choose_looks(camera, time, {0: True, 1: True, 2: False}, None, 10)
    assert len(looks.frames) == 2 * MOST + 12 and looks.fixed == {0, 1} and not looks.all_fixed
    assert looks.image_of_frame.tolist() == [0] * 12 + [1] * 12 + list(range(2, 14))
    across = [(looks.frames[a], looks.frames[b]) for a, b in looks.pairs if camera[looks.frames[a]] != camera[looks.frames[b]]]
    assert len(across) == 3 * MOST and all(time[a] == time[b] for a, b in across)
    assert len(looks.pairs) - len(across) == 12 * 11 // 2, "the moving camera's own frames"
    assert all(a != b for a, b in looks.image_pairs())


def test_many_cameras_are_looked_at_fewer_times():
    assert [look_times(n, 300) for n in (2, 4, 8, 12, 20, 40)] == [6, 6, 6, 3, 2, 2]
    assert look_times(4, 3) == 3


def test_frames_of_one_image_share_its_rows():
    arrays = {"registered": np.array([True, False]), "K": np.arange(18.0).reshape(2, 3, 3), "points": np.zeros((5, 3))}
    wide = expand(arrays, [0, 0, 1])
    assert wide["registered"].tolist() == [True, True, False] and (wide["K"][0] == wide["K"][1]).all() and len(wide["points"]) == 5


def test_misfit_prefers_the_true_cameras_whatever_a_third_of_the_matches_say():
    rng = np.random.default_rng(0)
    K, points = np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]]), rng.uniform([-1, -1, 4], [1, 1, 6], (200, 3))
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, :3, 3] = [-0.8, 0.1, 0.2]
    pixels = [(p := (points @ pose[:3, :3].T + pose[:3, 3]) @ K.T)[:, :2] / p[:, 2:] for pose in poses]
    pixels[1][:66] = rng.uniform(0, 240, (66, 2))
    true = {"K": np.stack([K, K]), "cam_from_world": poses, "distortion": np.zeros((2, 4)), "registered": np.ones(2, bool)}
    matches = {(0, 1): (pixels[0], pixels[1])}
    wrong = poses.copy()
    wrong[1, :3, 3] += [0, 0.02, 0]
    best = misfit(matches, true)
    assert best < misfit(matches, {**true, "cam_from_world": wrong}) - 0.3
    assert misfit(matches, {**true, "registered": np.array([True, False])}) == pytest.approx(np.log(np.hypot(FARTHEST, NOISE)))
    none = np.zeros((0, 2))
    assert misfit({**matches, (1, 0): (none, none)}, true) == best, "a pair that was matched in vain says nothing"


def test_a_camera_that_shares_nothing_is_named(videos_capture, tmp_path):
    folder = tmp_path / "odd"
    folder.mkdir()
    for name in ("a.mp4", "b.mp4", "c.mp4"):
        shutil.copy(videos_capture.root / name, folder / name)
    noise = np.random.default_rng(0).integers(0, 255, (180, 240, 3), np.uint8)
    write_mp4(folder / "odd.mp4", (noise for _ in range(TIMES)), 30)
    ran = run_poses(folder, tmp_path / "work")
    assert ran.artifact.read("registered").reshape(4, TIMES).all(axis=1).tolist() == [True, True, True, False]
    assert any("no frame of odd.mp4 has a pose" in line for line in ran.lines)
    request = json.loads((ran.context.checkpoints / "colmap" / "request.json").read_text())
    assert request["all_fixed"] and len(request["cameras"]) == 4
