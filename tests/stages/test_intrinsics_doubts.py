"""Lenses of transforms.json, and intrinsics that contradict each other or the pictures."""

import json
import math
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
from av.stream import Disposition
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from e4dgs.stages.captures.video.tracks import best_track
from factory import Options, make, write_colmap, write_nerfstudio
from PIL import Image

PATH = Options(backdrop="room", rig="path", times=4, width=40, height=32, samples=1, fov_degrees=60.0)
FOCAL = 20 / math.tan(math.radians(30))


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return write_nerfstudio(make(PATH), tmp_path_factory.mktemp("nerfstudio"))


@pytest.fixture
def changed(written, tmp_path):
    """`changed(key=value, ...)` is a copy of the capture with these fields; None removes one."""

    def change(**fields):
        root = shutil.copytree(written.root, tmp_path / "capture", dirs_exist_ok=True)
        data = json.loads((written.root / "transforms.json").read_text())
        data = {k: v for k, v in {**data, **fields}.items() if v is not None}
        (root / "transforms.json").write_text(json.dumps(data))
        return root

    return change


MATRIX = [[FOCAL, 0, 20], [0, FOCAL, 16], [0, 0, 1]]
WAYS = {
    "pixels": {},
    "angle": {"fl_x": None, "fl_y": None, "camera_angle_x": math.radians(60)},
    "both": {"camera_angle_x": 1.05, "camera_angle_y": 2 * math.atan(16 / FOCAL)},
    "degrees": {"fl_x": None, "fl_y": None, "x_fov": 60.0},
    "fov": {"fl_x": None, "fl_y": None, "fov": 60.0},
    "matrix": {"fl_x": None, "fl_y": None, "cx": None, "cy": None, "K": MATRIX},
    "matrix and pixels": {"intrinsics": MATRIX},
    "matrix of another size": {
        "fl_x": None,
        "fl_y": None,
        "cx": None,
        "cy": None,
        "w": 80,
        "h": 64,
        "K": [[2 * v for v in r] for r in MATRIX],
    },
}


@pytest.mark.parametrize("case", WAYS)
def test_ways_to_give_one_focal_length(changed, case):
    np.testing.assert_allclose(recognise(changed(**WAYS[case])).K[0], [*MATRIX[:2], [0, 0, 1]], rtol=1e-3)


CONTRADICTIONS = {
    "angle": ({"fl_x": 10.0, "fl_y": 10.0, "camera_angle_x": 0.85}, ("fl_x = 10 px", "camera_angle_x = 0.85 rad", "44.19 px")),
    "vertical angle": ({"camera_angle_y": 1.4}, ("fl_y = ", "camera_angle_y = 1.4 rad")),
    "degrees": ({"x_fov": 80.0}, ("fl_x = ", "x_fov = 80 degrees")),
    "matrix": ({"K": [[50, 0, 20], [0, 50, 16], [0, 0, 1]]}, ("fl_x = ", "the camera matrix (50 px)")),
    "centre": ({"K": [[FOCAL, 0, 30], [0, FOCAL, 16], [0, 0, 1]]}, ("cx = 20", "camera matrix says 30")),
    "angle of pictures twice as large": (
        {"fl_x": 2 * FOCAL, "fl_y": 2 * FOCAL, "camera_angle_x": math.radians(60), "w": None, "h": None},
        ("w and h",),
    ),
}


@pytest.mark.parametrize("case", CONTRADICTIONS)
def test_contradictions_name_both(changed, case):
    fields, words = CONTRADICTIONS[case]
    with pytest.raises(CaptureError) as caught:
        recognise(changed(**fields))
    assert all(word in str(caught.value) for word in ("transforms.json: frame 0", *words)), str(caught.value)


SENSORS = {  # size of the picture, the sensor's side that spans a side of it (px), angles that are ignored
    "wider than 3:2": ((40, 20), (36, 40), "camera_angle_y = {y:g} rad is"),
    "square": ((40, 40), (36, 40), "camera_angle_y = {y:g} rad is"),
    "upright": ((20, 40), (36, 40), "camera_angle_x = {x:g} rad and camera_angle_y = {y:g} rad are"),
    "fitted to the height": ((40, 20), (24, 20), "camera_angle_x = {x:g} rad is"),
    "3:2": ((42, 28), (36, 42), None),
}


@pytest.mark.parametrize("case", SENSORS)
def test_angles_of_blenders_sensor_do_not_contradict_focal_lengths(changed, case):
    """BlenderNeRF writes both for instant-ngp; a lens of 50 mm before a sensor of 36 mm by 24 mm."""
    size, (side, pixels), ignored = SENSORS[case]
    focal, x, y = 50 * pixels / side, 2 * math.atan(18 / 50), 2 * math.atan(12 / 50)
    fields = {"w": size[0], "h": size[1], "cx": size[0] / 2, "cy": size[1] / 2, "camera_angle_x": x, "camera_angle_y": y}
    root = changed(fl_x=focal, fl_y=focal, **fields)
    for picture in (root / "images").iterdir():
        Image.new("RGB", size).save(picture)
    capture = recognise(root, fps=30)
    np.testing.assert_allclose(capture.K[0], [[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]])
    told = [f"transforms.json: frame 0: fl_x and fl_y are used, and {ignored.format(x=x, y=y)} ignored"] if ignored else []
    assert [note.partition(", because")[0] for note in capture.notes] == told
    for wrong in ({"fl_x": 2 * focal, "fl_y": 2 * focal}, {"fl_x": 1.2 * focal, "fl_y": focal}):
        data = json.loads((root / "transforms.json").read_text())
        (root / "transforms.json").write_text(json.dumps(data | wrong))
        with pytest.raises(CaptureError, match="contradict each other"):
            recognise(root, fps=30)


def test_a_view_that_only_a_fisheye_has_is_refused(changed):
    with pytest.raises(CaptureError, match=r"images/000\.png: a focal length of 3 px .* 163 degrees"):
        recognise(changed(fl_x=3.0, fl_y=3.0))
    assert recognise(changed(fl_x=3.0, fl_y=3.0, camera_model="OPENCV_FISHEYE")).fisheye.all()


def test_a_principal_point_far_from_the_middle_is_told(changed):
    """cx equals the width: the intrinsics are those of pictures twice as large, whose size is missing."""
    root = changed(w=None, h=None, fl_x=2 * FOCAL, fl_y=2 * FOCAL, cx=40.0, cy=32.0)
    (note,) = recognise(root, fps=30).notes
    assert "principal point of 4 picture(s) lies outside the middle half" in note and "give that size (w and h)" in note
    assert not recognise(changed(cx=28.0), fps=30).notes
    (note,) = recognise(changed(fl_y=2 * FOCAL), fps=30).notes
    assert "pixels were not square" in note


def test_the_rational_model_has_six_radial_terms(changed):
    terms = {"k1": 0.01, "k2": -0.02, "p1": 0.001, "p2": -0.002, "k3": 0.003, "k4": 0.02, "k5": -0.01, "k6": 0.004}
    capture = recognise(changed(camera_model="FULL_OPENCV", **terms))
    np.testing.assert_allclose(capture.distortion[0], [0.01, -0.02, 0.001, -0.002, 0.003, 0.02, -0.01, 0.004])
    with pytest.raises(CaptureError, match="FULL_OPENCV lenses also have k4, k5, k6"):
        recognise(changed(camera_model="OPENCV", **terms))


def test_terms_may_be_a_list_in_the_order_of_nerfstudio(changed):
    listed = [0.01, -0.02, 0.003, 0.0, 0.001, -0.002]
    capture = recognise(changed(distortion_params=listed))
    np.testing.assert_allclose(capture.distortion[0], [0.01, -0.02, 0.001, -0.002, 0.003, 0, 0, 0])
    capture = recognise(changed(camera_model="OPENCV_FISHEYE", distortion_params=[0.01, -0.02, 0.003, 0.004]))
    np.testing.assert_allclose(capture.distortion[0], [0.01, -0.02, 0.003, 0.004])
    with pytest.raises(CaptureError, match="frame 0: distortion_params: expected a list of 6 numbers, found 4 entries"):
        recognise(changed(camera_model="OPENCV", distortion_params=listed[:4]))
    with pytest.raises(CaptureError, match="k4: OPENCV lenses have"):
        recognise(changed(distortion_params=[0.01, 0, 0, 0.02, 0, 0]))


@pytest.mark.parametrize("model", ["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "opencv"])
def test_perspective_models(changed, model):
    capture = recognise(changed(camera_model=model, k1=0.02))
    assert capture.distortion[0, 0] == 0.02 and capture.fisheye is None


@pytest.mark.parametrize("model", ["EQUIRECTANGULAR", "THIN_PRISM_FISHEYE", "FISHEYE624"])
def test_unknown_models_are_refused_by_name(changed, model):
    with pytest.raises(CaptureError, match=f"camera_model: {model} is not supported"):
        recognise(changed(camera_model=model))


@pytest.mark.parametrize("layout", ["nerfstudio", "colmap"])
def test_a_size_that_fits_once_exif_turns_the_picture_names_exif(changed, tmp_path, layout):
    root = changed() if layout == "nerfstudio" else write_colmap(make(PATH), tmp_path / "colmap").root
    exif = Image.Exif()
    exif[0x0112] = 6
    for file in (root / "images").iterdir():
        Image.open(file).resize((32, 40)).save(file, exif=exif)
    with pytest.raises(
        CaptureError, match=r"40x32, but images/000\.png is 32x40, because its EXIF orientation \(6\).*after which it is 40x32"
    ):
        recognise(root)


def test_what_a_frame_says_comes_before_what_the_file_says(changed):
    """A camera that zooms: the angle at the head of the file is that of no frame in particular."""
    root = changed(fl_x=None, fl_y=None, camera_angle_x=math.radians(60))
    data = json.loads((root / "transforms.json").read_text())
    data["frames"][2]["fl_x"] = 50.0
    data["frames"][3]["K"] = [[60, 0, 20], [0, 60, 16], [0, 0, 1]]
    (root / "transforms.json").write_text(json.dumps(data))
    np.testing.assert_allclose(recognise(root).K[:, 0, 0], [FOCAL, FOCAL, 50, 60], rtol=1e-6)


@pytest.mark.parametrize(("size", "doubted"), [((80, 60), True), ((160, 120), False), ((310, 232), True), ((120, 90), False)])
def test_a_camera_matrix_for_pictures_of_another_size_is_doubted(tmp_path, size, doubted):
    """Of twice the size, the principal point lies at the corner, and a little more is outside, which is an error."""
    for i in range(3):
        Image.new("RGB", (160, 120), (i, 0, 0)).save(tmp_path / f"{i}.png")
    (tmp_path / "K.txt").write_text(f"200 0 {size[0] / 2}\n0 200 {size[1] / 2}\n0 0 1\n")
    told = [note for note in recognise(tmp_path).notes if "principal point" in note]
    assert bool(told) == doubted and all(f"K.txt: the principal point {size[0] / 2:g}, " in note for note in told)
    assert all(f"made for about {size[0]}x{size[1]} px: then scale its first two rows" in note for note in told)


def test_of_a_depth_camera_the_track_in_colour_is_read():
    """Azure Kinect: depth and infrared may have more pixels than colour."""
    kinds = [("yuvj422p", 1280, 720), ("gray16be", 1024, 1024), ("gray16be", 1024, 1024)]
    streams = [
        SimpleNamespace(
            codec_context=SimpleNamespace(pix_fmt=kind), width=width, height=height, index=i, frames=9, disposition=Disposition.default
        )
        for i, (kind, width, height) in enumerate(kinds)
    ]
    for order in (streams, streams[::-1]):
        assert best_track(SimpleNamespace(streams=SimpleNamespace(video=order)), "k4a.mkv").codec_context.pix_fmt == "yuvj422p"
    assert best_track(SimpleNamespace(streams=SimpleNamespace(video=streams[1:])), "grey.mkv").index == 1
