"""One camera that stands still: recognised, with one pose, its background once, and what moves before that."""

import json
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from e4dgs.scene.seeds.one_place import DISTANCE, assumed_depth, background
from e4dgs.stages.captures.recognise import recognise
from e4dgs.stages.facts import STANDS_STILL, Facts
from e4dgs.stages.shared.frameset import FrameSet
from e4dgs.vision.depth.together import FARTHEST, depth_of_inverse, is_inverse, scale_together
from e4dgs.vision.sfm.fixed_cameras import SHAKEN, is_fixed
from factory import Options, make, render
from factory.render import to_uint8
from PIL import Image
from run_stage import run_poses

WIDTH, HEIGHT, COUNT = 320, 240, 9


@pytest.fixture(scope="module")
def textured() -> np.ndarray:
    scene = make(Options(backdrop="room", rig="arc", cameras=1, times=1, width=WIDTH, height=HEIGHT, samples=1, motion=0.0))
    return to_uint8(render(scene.scene, scene.views[0].camera, 0.0, 1).image)[..., :3]


def shifted(picture, x, y=0.0, noise=0.0, k=0):
    moved = cv2.warpAffine(picture, np.array([[1.0, 0, x], [0, 1, y]]), (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT)
    return np.clip(moved + np.random.default_rng(k).normal(0, noise, moved.shape), 0, 255).astype(np.uint8)


def walked(picture, k):
    """``picture`` with a patch before it, which is elsewhere at each time."""
    result = picture.copy()
    result[80:200, 20 + 25 * k : 80 + 25 * k] = np.random.default_rng(7).integers(0, 255, (120, 60, 3), np.uint8)
    return result


@pytest.fixture(scope="module")
def tripod(textured, tmp_path_factory):
    folder = tmp_path_factory.mktemp("tripod")
    for k in range(COUNT):
        Image.fromarray(walked(textured, k)).save(folder / f"{k}.png")
    return folder


@pytest.mark.parametrize(("reach", "stands"), [(0.0, True), (0.8, True), (1.6, False), (5.0, False)])
def test_a_shake_of_less_than_a_pixel_to_either_side_stands_still(textured, reach, stands):
    shakes = [shifted(textured, reach * (-1) ** k, reach * (-1) ** (k // 2), 4.0, k) for k in range(7)]
    assert is_fixed(shakes.__getitem__, range(7), SHAKEN) is stands


@pytest.mark.parametrize(("way", "stands"), [(1.0, True), (3.0, False), (30.0, False)])
def test_a_pan_is_no_camera_that_stands_still(textured, way, stands):
    pan = [shifted(textured, way * k / 6) for k in range(7)]
    assert is_fixed(pan.__getitem__, range(7), SHAKEN) is stands


def test_a_zoom_is_none_either(textured):
    def zoomed(k: int) -> np.ndarray:
        grown = cv2.getRotationMatrix2D((WIDTH / 2, HEIGHT / 2), 0, 1 + 0.01 * k)
        return cv2.warpAffine(textured, grown, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT)

    assert not is_fixed(zoomed, range(7), SHAKEN)


def test_it_gets_one_pose_and_no_structure_from_motion(tripod, tmp_path):
    ran = run_poses(tripod, tmp_path)
    poses = ran.artifact.read("cam_from_world")
    assert (poses == np.eye(4)).all() and ran.artifact.read("registered").all() and not len(ran.artifact.read("points"))
    K = ran.artifact.read("K")[0]
    assert (K[0, 0], K[1, 1], K[0, 2], K[1, 2]) == (WIDTH, WIDTH, WIDTH / 2, HEIGHT / 2)
    assert ran.artifact.attrs["fixed_cameras"] and ran.artifact.attrs["limits"] == STANDS_STILL and STANDS_STILL in ran.lines
    assert any("53 degrees along the longer side are assumed" in line and "K.txt" in line for line in ran.lines)
    assert not list(tmp_path.rglob("*.db")), "no features were computed"
    frames = FrameSet(ran.context.inputs["frames"], tripod, ran.artifact)
    assert frames.stands_still and len(frames.train) and len(frames.test)


def test_the_lens_comes_from_a_matrix_or_from_the_data_of_the_pictures(textured, tmp_path):
    def lens(name, K=None, film=None):
        folder = tmp_path / name
        folder.mkdir()
        exif = Image.Exif()
        if film is not None:
            exif[0x8769] = {0xA405: film}
        for k in range(3):
            Image.fromarray(walked(textured, k)).save(folder / f"{k}.jpg", quality=95, exif=exif)
        if K is not None:
            (folder / "K.txt").write_text(K)
        return run_poses(folder, tmp_path / f"{name}_work").artifact.read("K")[0]

    assert lens("matrix", "300 0 150 0 310 110 0 0 1", 28).ravel().tolist() == [300, 0, 150, 0, 310, 110, 0, 0, 1]
    assert lens("exif", film=27)[0, 0] == pytest.approx(0.75 * WIDTH)


def still_views(pictures):
    count = len(pictures)
    return SimpleNamespace(train=np.arange(count), load=pictures.__getitem__, width=WIDTH, height=HEIGHT)


def test_the_background_shows_what_a_mask_hid_most_of_the_time(textured):
    """Something stands there for seven of nine times: a median alone would keep it."""
    pictures, masks = [], []
    for k in range(9):
        hidden = np.zeros((HEIGHT, WIDTH), bool)
        hidden[50:150, 100:200] = k < 7
        pictures.append(np.where(hidden[..., None], 255, textured).astype(np.uint8))
        masks.append(hidden)
    assert (background(still_views(pictures), masks.__getitem__) == textured).all()
    never = background(still_views(pictures[:7]), masks.__getitem__)
    assert (never[100, 150] == 255).all() and (never[0, 0] == textured[0, 0]).all()


def test_the_assumed_floor_is_level_and_joins_the_wall():
    K = np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]])
    depth = assumed_depth(K, WIDTH, HEIGHT)
    assert (depth[:120] == DISTANCE).all() and (np.diff(depth[:, 0]) <= 0).all() and np.abs(np.diff(depth[:, 0])).max() < 0.1 * DISTANCE
    rows = np.arange(180, HEIGHT)
    height = depth[rows, 0] * (rows + 0.5 - 120) / 300  # below the camera
    np.testing.assert_allclose(height, height[0], rtol=1e-5)


@pytest.mark.parametrize("masked", [True, False])
def test_given_depth_is_scaled_without_known_points(masked):
    """Something at another depth passes; with masks it may also stand there for as long as it likes."""
    rng = np.random.default_rng(0)
    true = np.tile(np.linspace(2, 9, 60), (40, 1))
    true[:4] = 0
    factors, maps, rest = 1000 * rng.uniform(0.8, 1.2, 5), {}, {}
    for i in range(5):
        moves = np.zeros((40, 60), bool)
        moves[10:30, 20:30] = True
        moves = moves if masked else np.roll(moves, 8 * i, axis=1)
        maps[i], rest[i] = factors[i] * np.where(moves, 1.5, true), ~moves if masked else None
    scales, errors = scale_together(maps, rest, DISTANCE)
    z = {i: maps[i] / scales[i][0] for i in maps}
    still = (true > 0) & (maps[0] == factors[0] * true)
    assert np.median(z[0][still]) == pytest.approx(DISTANCE, rel=0.02 if masked else 0.1)
    assert max(errors.values()) < 1e-5 and (z[2][:4] == 0).all()
    for i in range(1, 5):
        same = still & (maps[i] == factors[i] * true)
        np.testing.assert_allclose(z[i][same], z[0][same], rtol=1e-4)
    assert z[0][20, 25] / z[0][20, 40] == pytest.approx(1.5 / true[20, 40], rel=1e-3)


def passing(count, share=0.05, shift=0.0, noise=0.02):
    """Inverse depth of a wall and floor by frame; something nearer passes over ``share`` of it in all but the first two frames."""
    rng, maps = np.random.default_rng(1), {}
    wall = np.tile(np.linspace(0.1, 0.5, 60)[:, None], (1, 80))
    for i in range(count):
        inverse = wall.copy()
        if i > 1 and share:
            inverse[20:40, 8 * i : 8 * i + max(1, round(share * 240))] = 0.6
        maps[i] = rng.uniform(0.5, 2) * (inverse + shift) * np.exp(noise * rng.normal(size=wall.shape))
    return maps


@pytest.mark.parametrize("shift", [0.0, 0.2])
def test_what_passes_tells_distances_from_inverse_ones(shift):
    maps = passing(8, shift=shift)
    assert is_inverse(maps) is True
    assert is_inverse({i: 1 / one for i, one in maps.items()}) is False


@pytest.mark.parametrize(("share", "noise", "found"), [(0.0, 0.02, None), (0.004, 0.02, True), (0.05, 0.2, None)])
def test_no_change_tells_nothing_and_noise_hides_what_passes(share, noise, found):
    assert is_inverse(passing(8, share=share, noise=noise)) is found


def test_no_map_tells_nothing():
    assert is_inverse({0: np.zeros((4, 4))}) is None


def test_inverse_depth_without_known_points_has_no_shift_and_ends_far_away():
    values = np.array([[0.0, 0.5, 1.0], [2.0, 1.0, 1e-6]])
    np.testing.assert_allclose(depth_of_inverse(values), [[0, 2, 1], [0.5, 1, FARTHEST]], rtol=1e-6)


@pytest.mark.parametrize("other", [0.0, 0.1])
def test_poses_of_files_that_are_all_equal_are_one_camera_that_stands_still(tripod, tmp_path, other):
    frames = []
    for k in range(COUNT):
        pose = np.eye(4)
        pose[0, 3] = other * k
        (tmp_path / f"{k}.png").symlink_to(tripod / f"{k}.png")
        frames.append({"file_path": f"{k}.png", "transform_matrix": pose.tolist(), "time": k / (COUNT - 1)})
    (tmp_path / "transforms.json").write_text(json.dumps({"fl_x": 300, "w": WIDTH, "h": HEIGHT, "frames": frames}))
    capture = recognise(tmp_path)
    facts = Facts.of(capture.facts)
    assert facts.stands_still is (other == 0) and facts.poses and facts.cameras == 1 and facts.pairs > 0
    assert (STANDS_STILL in capture.notes) is (other == 0)
