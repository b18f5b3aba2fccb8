"""Path files: the lens, size, rate and times that they state are used, and what is not used is named."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.workflows.exports.camera_path import NERFSTUDIO, path_of_file

WIDTH, HEIGHT, FOCAL = 64, 48, 70.0
EYE = np.eye(4).tolist()
CAPTURE = SimpleNamespace(
    K=np.array([[[FOCAL, 0, 31.0], [0, FOCAL, 25.0], [0, 0, 1]]]), train=np.array([0]), origin=None, width=WIDTH, height=HEIGHT
)


def read(tmp_path, data):
    file = tmp_path / "path.json"
    file.write_text(json.dumps(data))
    return path_of_file(file, CAPTURE)


def views(*rows, **top):
    return {**top, "frames": [{"cam_from_world": EYE, **row} for row in rows]}


def lens(fx: float, fy: float, cx: float, cy: float) -> list[list[float]]:
    return [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]


TELE = 0.5 * WIDTH / math.tan(0.15)


@pytest.mark.parametrize(
    ("data", "size", "expected"),
    [
        (views({}), (64, 48), lens(70, 70, 31, 25)),
        (views({}, camera_angle_x=0.3), (64, 48), lens(TELE, TELE, 32, 24)),
        (views({"camera_angle_x": 0.3}, camera_angle_x=0.9), (64, 48), lens(TELE, TELE, 32, 24)),
        (views({}, camera_angle_x=0.3, camera_angle_y=0.3), (64, 48), lens(TELE, 0.75 * TELE, 32, 24)),
        (views({}, fl_x=100, w=128, h=96), (128, 96), lens(100, 100, 64, 48)),
        (views({}, fl_x=100, fl_y=110, cx=60, cy=50, w=128, h=96), (128, 96), lens(100, 110, 60, 50)),
        (views({"fl_x": 100, "cx": 60, "w": 128, "h": 96}), (128, 96), lens(100, 100, 60, 48)),
        (views({"cx": 60}, fl_x=100, w=128, h=96), (128, 96), lens(100, 100, 60, 48)),
        (views({"K": lens(90, 91, 30, 20)}), (64, 48), lens(90, 91, 30, 20)),
        (views({}, K=lens(90, 91, 30, 20), w=100, h=50), (100, 50), lens(90, 91, 30, 20)),
        (views({"fov": 90}, render_width=200, render_height=100), (200, 100), lens(50, 50, 100, 50)),
        (views({"fov": 90, "aspect": 2.0}), (64, 32), lens(16, 16, 32, 16)),
        (views({}, aspect=0.5), (32, 64), lens(70 * 4 / 3, 70 * 4 / 3, 16 - 4 / 3, 32 + 4 / 3)),
        (views({"fov": 90}, fl_x=500), (64, 48), lens(24, 24, 32, 24)),  # what a view says itself comes first
        (views({}, w=128, h=96), (128, 96), lens(140, 140, 62, 50)),  # the capture's lens, at twice the size
    ],
)
def test_the_lens_and_size_of_a_file_are_used(tmp_path, data, size, expected):
    path = read(tmp_path, data)
    assert path.size == size
    np.testing.assert_allclose(path.K[0], expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (views({}, fl_x=100, camera_angle_x=0.3), "fl_x and camera_angle_x disagree about the lens .*remove one"),
        (views({}, fl_x=100, fov=90), "fl_x and fov disagree"),
        (views({}, w=128), "it has w without h"),
        (views({}, w=128, h=96, render_width=200, render_height=150), "pictures of 200x150, but .* says 128x96"),
        (views({"w": 128, "h": 96}, {"w": 96, "h": 128}), "frame 1: pictures of 96x128, but .*frame 0 says 128x96"),
        (views({"aspect": 1.0}, {"aspect": 2.0}), "several values of aspect"),
        (views({}, cx=30), "it has cx but nothing that says how wide"),
        (views({}, camera_angle_x=4), "camera_angle_x"),
        (views({"fov": -1}), "frame 0: fov"),
        (views({"fov": "wide"}), "frame 0: fov: expected a number"),
        (views({}, w=0, h=10), "w: 0 lies outside"),
        (views({}, camera_type="equirectangular"), "camera_type 'equirectangular': only perspective"),
        (views({}, camera_model="OPENCV_FISHEYE"), "camera_model 'OPENCV_FISHEYE'"),
        (views({"camera_type": "fisheye"}), "frame 0: camera_type 'fisheye'"),
        (views({}, is_fisheye=True), "is_fisheye"),
        (views({"transform_matrix": EYE}), "both cam_from_world and transform_matrix"),
        ({"frames": [], "camera_path": []}, 'both "frames" and "camera_path"'),
        ({"camera_path": [{"camera_to_world": [1.0] * 15}]}, "frame 0: camera_to_world"),
        (views({"time": 0.5}, {}), "frame 1: it has no time, but other frames have"),
        (views({"time": float("nan")}), "frame 0: time: expected a number from 0 to 1"),
        (views({"time": 1.7}), "frame 0: time"),
        (views({"render_time": -0.1}), "frame 0: time"),
        (views({}, fps=0), "fps"),
        (views({}, seconds=float("inf")), "seconds: not a finite"),
    ],
)
def test_what_contradicts_itself_or_is_not_rendered_is_refused_by_name(tmp_path, data, words):
    with pytest.raises(CaptureError, match=words):
        read(tmp_path, data)


def nerfstudio() -> dict:
    """A file as nerfstudio's viewer writes it: a camera at (0, 0, 4) that looks at the origin, and one beside it."""

    def row(x: float, time: float) -> dict:
        return {"camera_to_world": [1, 0, 0, x, 0, 1, 0, 0, 0, 0, 1, 4, 0, 0, 0, 1], "fov": 60.0, "aspect": 16 / 9, "render_time": time}

    return {
        "default_fov": 75.0, "default_transition_sec": 2.0, "keyframes": [{"matrix": "[]", "fov": 60.0}], "camera_type": "perspective",
        "render_height": 270, "render_width": 480, "fps": 24, "seconds": 4.0, "is_cycle": False, "smoothness_value": 0.5, "crop": None,
        "camera_path": [row(0.01 * k, k / 95) for k in range(96)],
    }  # fmt: skip


def test_nerfstudio_s_camera_path_is_read(tmp_path):
    path = read(tmp_path, nerfstudio())
    assert path.size == (480, 270) and path.fps == 24 and path.notes == (NERFSTUDIO,)
    focal = 135 / math.tan(math.radians(30))
    np.testing.assert_allclose(path.K, np.tile(lens(focal, focal, 240, 135), (96, 1, 1)))
    np.testing.assert_allclose(path.time, np.arange(96) / 95)
    np.testing.assert_allclose(path.cam_from_world[1] @ [0.01, 0, 0, 1], [0, 0, 4, 1], atol=1e-9)
    np.testing.assert_allclose(path.cam_from_world[0] @ [0, 1, 0, 1], [0, -1, 4, 1], atol=1e-9)


def test_what_is_not_used_is_named(tmp_path):
    data = nerfstudio() | {"crop": {"crop_center": [0, 0, 0]}, "seconds": 10.0}
    data["camera_path"][3] |= {"aperture": 2.8, "aspect": 1.0}
    path = read(tmp_path, data)
    assert path.fps == 9.6
    told = "\n".join(path.notes)
    for words in (
        "these fields are not read: aperture, crop",
        "the video takes 10 s",
        "aspect (1) is not that of pictures of 480x270 in 1 ",
    ):
        assert words in told, told
    told = "\n".join(read(tmp_path, views({"file_path": "a.png"}, fl_x=70, k1=0.1, k2=0.0, p1=-0.01)).notes)
    assert "distortion of the lens (k1, p1) is not rendered" in told and "px of pictures of 64x48" in told and "file_path" not in told
    assert read(tmp_path, views({"time": 0.5}, w=64, h=48, fl_x=70, camera_model="OPENCV", k1=0.0)).notes == ()


def test_a_name_of_a_field_cannot_break_a_line(tmp_path):
    (note,) = read(tmp_path, views({}, **{"a\nb[red]": 1})).notes
    assert "\n" not in note and "a\\nb[red]" in note
