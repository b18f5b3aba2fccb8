"""Static is said on positive evidence alone: rendered rooms that are static or not, fixed cameras, and features placed by hand."""

from types import SimpleNamespace

import cv2
import e4dgs.vision.moving.static_scene as judge
import numpy as np
import pytest
from e4dgs.vision.moving.static_matches import Features, compare
from e4dgs.vision.moving.static_scene import static_scene
from e4dgs.vision.moving.two_view import TwoView
from factory import Options, make, render, to_uint8


def room(motion: float, times: int = 14, rig: str = "path") -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    options = Options(backdrop="room", rig=rig, times=times, motion=motion, width=320, height=240, samples=1, fov_degrees=60.0, seed=1)
    synthetic = make(options)
    pictures = [np.ascontiguousarray(to_uint8(render(synthetic.scene, v.camera, v.time, 1).image)[..., :3]) for v in synthetic.views]
    return pictures, np.stack([v.camera.K for v in synthetic.views]), np.stack([v.camera.cam_from_world for v in synthetic.views])


@pytest.fixture(scope="module")
def static():
    return room(0.0)


@pytest.fixture(scope="module")
def moving():
    return room(1.0)


def decide(pictures, K=None, poses=None, camera=None, time=None, fixed=False, untimed=False):
    count = len(pictures)
    camera = np.zeros(count, int) if camera is None else camera
    time = np.arange(count) / count if time is None else time
    return static_scene(pictures.__getitem__, camera, time, fixed, K, poses, untimed)


@pytest.mark.parametrize(("posed", "thin"), [(False, 1), (False, 3), (True, 3)])
def test_a_camera_that_passes_a_static_room_and_one_in_which_things_move(static, moving, posed, thin):
    found = [decide(p[::thin], *((K[::thin], poses[::thin]) if posed else ())) for p, K, poses in (static, moving)]
    assert found[0].static and found[0].largest_moving_share < 0.001 and "obey the camera's motion" in found[0].reason
    assert not found[1].static and found[1].largest_moving_share > 0.001 and "against the camera's motion" in found[1].reason
    assert found[0].evidence["unlinked"] == 0 and found[0].evidence["supporting"] > 300


@pytest.mark.parametrize(("thin", "untimed"), [(1, False), (1, True), (2, True)])
def test_photos_without_times_are_judged_by_the_same_motion(static, moving, thin, untimed):
    found = [decide(p[::thin], K[::thin], poses[::thin], untimed=untimed) for p, K, poses in (static, moving)]
    assert [one.static for one in found] == [True, False], found


def test_flow_between_photos_that_are_far_apart_is_no_motion(monkeypatch, static):
    """Flow that finds a tenth of each picture moving: believed between frames of a video, and between photos that are near."""
    pictures, K, poses = static
    monkeypatch.setattr(judge, "moving_mask", lambda image, found: np.arange(image.shape[0])[:, None] < 0.1 * image.shape[0])
    monkeypatch.setattr(judge, "frame_evidence", lambda followed: SimpleNamespace(weight=np.ones((240, 320)), score=np.ones((240, 320))))
    for travel, untimed, static in ((0.02, False, False), (0.02, True, False), (0.04, False, False), (0.04, True, True)):
        monkeypatch.setattr(judge, "_travel", lambda flow, sure, travel=travel: travel)
        assert decide(pictures, K, poses, untimed=untimed).static is static, (travel, untimed)


def test_poses_that_do_not_fit_are_no_evidence(static):
    pictures, K, poses = static
    for untimed in (False, True):
        assert not decide(pictures[::3], K[::3], poses[::3][::-1], untimed=untimed).static


def test_the_decision_is_the_same_twice(static):
    pictures = static[0][::3]
    assert decide(pictures) == decide(pictures)


def test_pictures_that_show_nothing_in_common_or_nothing_at_all_are_not_static(static):
    plain = [np.full((120, 160, 3), 128, np.uint8)] * 4
    noise = [np.random.default_rng(k).integers(0, 256, (120, 160, 3), dtype=np.uint8) for k in range(4)]
    odd = [*static[0][::4], cv2.resize(noise[0], (320, 240))]
    for pictures in (plain, noise, odd):
        found = decide(pictures)
        assert not found.static and "too little in common" in found.reason
    assert not decide(plain[:1]).static
    assert not decide([np.zeros((8, 8, 3), np.uint8)] * 5).static


def cameras(change: bool, count: int = 2, times: int = 6, plain: bool = False):
    """Fixed cameras with noise and flicker; in one frame of the last, something small passes."""
    rng = np.random.default_rng(5)
    frames = []
    for c in range(count):
        backdrop = cv2.resize(rng.integers(0, 256, (12, 16, 3), dtype=np.uint8), (160, 120), interpolation=cv2.INTER_CUBIC)
        for k in range(times):
            frame = np.full(backdrop.shape, 90.0) if plain else backdrop.astype(float) * 0.7 + 20 + k % 2
            if change and c == count - 1 and k == 3:
                frame[60:66, 70:76] = 255 - frame[60:66, 70:76]
            frames.append(np.clip(frame + rng.normal(0, 1.5, frame.shape), 0, 255).astype(np.uint8))
    return frames, np.repeat(np.arange(count), times), np.tile(np.arange(times) / times, count)


@pytest.mark.parametrize(
    ("options", "static", "words"),
    [
        ({"change": False}, True, "no pixel of 2 fixed cameras changes over 6 times"),
        ({"change": True}, False, "pixels change"),
        ({"change": False, "plain": True}, False, "plain"),
        ({"change": False, "times": 1}, False, "no camera saw two times"),
    ],
)
def test_fixed_cameras_are_static_where_no_pixel_changes(options, static, words):
    frames, camera, time = cameras(**options)
    found = decide(frames, camera=camera, time=time, fixed=True)
    assert found.static is static and words in found.reason


def placed(extra: int, repeated: bool = False, apart: float = 6.0) -> tuple[Features, Features, TwoView]:
    """200 features that move sideways as a camera's would, and `extra` beside each other that move down by 25 px instead."""
    rng = np.random.default_rng(2)
    first = rng.uniform(20, 300, (200 + extra, 2))
    first[200:] = (150, 150) + apart * np.arange(extra)[:, None] * [1, 0.3]
    second = first + np.column_stack([rng.uniform(5, 15, 200 + extra), np.zeros(200 + extra)])
    second[200:] = first[200:] + np.array([3, 25])
    unit = rng.normal(size=(200 + extra, 128))
    if repeated:  # a row of windows: every one looks like others that did not match
        unit[100 : 100 + extra] = unit[200:] + 0.05 * rng.normal(size=(extra, 128))
    other = unit + rng.normal(size=unit.shape) * np.where(np.arange(200 + extra) < 200, 0.2, 0.15)[:, None]
    sideways = TwoView("epipolar", np.array([[0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]))
    features = [
        Features(xy, (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)) for xy, d in ((first, unit), (second, other))
    ]
    return features[0], features[1], sideways


@pytest.mark.parametrize(("extra", "moving"), [(0, 0), (2, 0), (3, 3), (8, 8)])
def test_three_distinctive_features_that_move_together_are_motion(extra, moving):
    first, second, model = placed(extra)
    found = compare(first, second, 320, model)
    assert found.supporting == 200 and found.moving == moving


def test_scattered_mismatches_and_repeated_structures_are_no_motion():
    first, second, model = placed(8, repeated=True)
    assert compare(first, second, 320, model).moving == 0
    for extra, apart in ((4, 45.0), (3, 18.0), (4, 18.0)):  # of those in a row, only the ones in the middle have two others near them
        first, second, model = placed(extra, apart=apart)
        assert compare(first, second, 320, model).moving == 0


def test_no_features_are_no_evidence():
    nothing = Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    first, _, model = placed(0)
    for a, b in ((nothing, first), (first, nothing), (nothing, nothing)):
        assert compare(a, b, 320, model).supporting == 0
