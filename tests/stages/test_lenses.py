"""Lenses of every kind that is read: what the files say, the pinhole camera that is made of it, and that each of its pixels was seen."""

import json
import shutil

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from e4dgs.stages.shared.frameset import FrameSet
from e4dgs.vision.images.lenses import pinholes, undistort_maps
from factory import Camera, Options, make, render, write_colmap, write_nerfstudio
from factory.writers import flatten
from run_stage import run_frames

WIDTH, HEIGHT = 80, 64
K = np.array([[70.0, 0, 41.5], [0, 71.0, 31.0], [0, 0, 1]])
LENSES = {
    "barrel": ((-0.2, 0.03, 0.0, 0.0), False),
    "pincushion": ((0.15, 0.05, 0.002, -0.003), False),
    "six terms": ((0.3, 0.1, 0.001, 0.002, 0.02, 0.25, 0.05, 0.01), False),
    "fisheye": ((-0.02, 0.01, -0.003, 0.001), True),
    "equidistant": ((0.0, 0.0, 0.0, 0.0), True),
}


def lens(name, K=K):
    terms, fisheye = LENSES[name]
    return Camera(K, np.eye(4), WIDTH, HEIGHT, terms, fisheye)


def seen_by(camera, K):
    """Places [H,W,2] px in the lens's picture that the pixels of the pinhole camera K show: the factory's own formulas."""
    pixels = Camera(K, np.eye(4), WIDTH, HEIGHT).pixel_centres()
    rays = np.linalg.solve(K, np.concatenate([pixels, np.ones((HEIGHT, WIDTH, 1))], -1)[..., None])[..., 0]
    return camera.project(rays)[0]


def inside(places, margin=0.0):
    return ((places >= -margin) & (places <= np.array([WIDTH, HEIGHT]) + margin)).all(-1)


@pytest.mark.parametrize("name", LENSES)
def test_every_pixel_of_the_pinhole_camera_was_seen_and_no_more_is_cut_than_that_takes(name):
    camera = lens(name)
    found, kept = pinholes(K[None], np.array([camera.distortion]), np.array([camera.fisheye]), WIDTH, HEIGHT)
    assert inside(seen_by(camera, found[0]), margin=1e-3).all() and 0.5 < kept[0] <= 1
    if inside(seen_by(camera, K)).all():
        np.testing.assert_array_equal(found[0], K)
    else:
        zoom = found[0, 0, 0] / K[0, 0]
        middle = np.array([[1, 0, WIDTH / 2], [0, 1, HEIGHT / 2], [0, 0, 1]])
        less = middle @ np.diag([0.995, 0.995, 1]) @ np.linalg.inv(middle) @ found[0]
        assert 1 < zoom < 1.3 and not inside(seen_by(camera, less), margin=1e-3).all()
    # what is kept of the picture: the share of its pixels that some pixel of the pinhole camera looks at
    looked_at = np.zeros((HEIGHT, WIDTH), bool)
    x, y = np.floor(seen_by(camera, found[0]) - 1e-6).astype(int).reshape(-1, 2).T
    for dx, dy in np.ndindex(3, 3):
        looked_at[np.clip(y + dy - 1, 0, HEIGHT - 1), np.clip(x + dx - 1, 0, WIDTH - 1)] = True
    assert looked_at.mean() - 0.07 < kept[0] <= looked_at.mean()


def test_only_some_of_these_lenses_need_a_longer_focal_length():
    """So that the test above has cases of both kinds."""
    assert {name for name in LENSES if not inside(seen_by(lens(name), K)).all()} == {"pincushion", "six terms"}


@pytest.mark.parametrize("name", LENSES)
def test_maps_lead_to_the_place_that_the_lens_puts_a_ray(name):
    camera = lens(name)
    found, _ = pinholes(K[None], np.array([camera.distortion]), np.array([camera.fisheye]), WIDTH, HEIGHT)
    x, y = undistort_maps(found[0], np.array(camera.distortion), WIDTH, HEIGHT, K, camera.fisheye)
    np.testing.assert_allclose(np.stack([x, y], -1) + 0.5, seen_by(camera, found[0]), atol=1e-4)


@pytest.mark.parametrize("terms", [(-8.0, 0, 0, 0), (60.0, 0, 0, 0), (-100.0, 100.0, 0, 0), (0, 0, 0, 0, 0, -50.0, 0, 0)])
def test_lenses_that_fold_the_picture_over_are_found(terms):
    found, kept = pinholes(K[None], np.array([terms], float), None, WIDTH, HEIGHT)
    assert kept[0] == 0 and (found[0] == K).all()


def test_frames_without_a_pose_pass_through():
    found, kept = pinholes(np.full((2, 3, 3), np.nan), np.ones((2, 4)), None, WIDTH, HEIGHT)
    assert np.isnan(found).all() and (kept == 1).all()


@pytest.mark.parametrize("write", [write_nerfstudio, write_colmap])
@pytest.mark.parametrize(
    ("terms", "fisheye"), [((0.1, 0.02, 0.001, -0.001, 0.01), False), ((-0.03, 0.01, 0.0, 0.0), True), ((0.0, 0.0, 0.0, 0.0), True)]
)
def test_pictures_equal_those_of_the_pinhole_camera(tmp_path, write, terms, fisheye):
    """Against a render of the same scene without a lens; a shift of half a pixel would already fail."""
    if write is write_colmap and len(terms) == 5:
        terms = (*terms, 0.0, 0.0, 0.0)
    options = Options(backdrop="room", rig="path", times=3, width=WIDTH, height=HEIGHT, fov_degrees=75.0, distortion=terms, fisheye=fisheye)
    capture = write(make(options), tmp_path / "capture")
    ran = run_frames(capture.root, tmp_path, holdout=0)
    frames = FrameSet(ran.artifact, capture.root)
    view = capture.views[1]
    pinhole = Camera(frames.K[1], view.camera.cam_from_world, WIDTH, HEIGHT)
    truth = flatten(render(capture.synthetic.scene, pinhole, view.time, 4)).astype(float)
    error = np.square(frames.image(1).astype(float) - truth).mean((1, 2))
    assert 10 * np.log10(255**2 / error.mean()) > 24
    assert 10 * np.log10(255**2 / error[[0, -1]].mean()) > 20, "the first and last rows are pictures, too"
    moved = np.square(np.roll(frames.image(1), 1, 1).astype(float) - truth).mean()
    assert error.mean() < moved / 3
    assert sum("3 of 3 pictures are undistorted" in line for line in ran.lines) == 1
    assert ("lens_K" in ran.artifact) == (not fisheye), "what curves outwards needs a longer focal length"


MODELS = {
    "SIMPLE_PINHOLE": [70, 40, 31],
    "PINHOLE": [70, 71, 40, 31],
    "SIMPLE_RADIAL": [70, 40, 31, 0.05],
    "RADIAL": [70, 40, 31, 0.05, -0.01],
    "OPENCV": [70, 71, 40, 31, 0.05, -0.01, 0.001, 0.002],
    "FULL_OPENCV": [70, 71, 40, 31, 0.05, -0.01, 0.001, 0.002, 0.003, 0.01, 0.02, 0.004],
    "SIMPLE_FISHEYE": [70, 40, 31],
    "FISHEYE": [70, 71, 40, 31],
    "SIMPLE_RADIAL_FISHEYE": [70, 40, 31, 0.05],
    "RADIAL_FISHEYE": [70, 40, 31, 0.05, -0.01],
    "OPENCV_FISHEYE": [70, 71, 40, 31, 0.05, -0.01, 0.004, -0.002],
}


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("model", MODELS)
def test_colmap_models_mean_what_colmap_says(colmap_capture, tmp_path, model, binary):
    """COLMAP itself projects rays with the camera that was written; ours, read from the file, puts them at the same pixels."""
    pycolmap = pytest.importorskip("pycolmap")
    root = shutil.copytree(colmap_capture.root, tmp_path / "capture")
    (root / "sparse/0/cameras.txt").write_text(f"1 {model} {WIDTH} {HEIGHT} {' '.join(map(str, MODELS[model]))}\n")
    theirs = pycolmap.Reconstruction(str(root / "sparse/0"))
    if binary:
        for file in (root / "sparse/0").glob("*.txt"):
            file.unlink()
        theirs.write_binary(str(root / "sparse/0"))
    capture = recognise(root)
    rays = np.random.default_rng(0).uniform([-0.5, -0.4, 1], [0.5, 0.4, 1], (50, 3))
    fisheye = capture.fisheye is not None and bool(capture.fisheye[0])
    ours = Camera(capture.K[0], np.eye(4), WIDTH, HEIGHT, tuple(capture.distortion[0]), fisheye).project(rays)[0]
    np.testing.assert_allclose(ours, theirs.camera(1).img_from_cam(rays), atol=1e-9)


def test_lens_terms_of_one_frame_win(nerfstudio_capture, tmp_path):
    root = shutil.copytree(nerfstudio_capture.root, tmp_path / "own")
    data = json.loads((root / "transforms.json").read_text())
    data["frames"][2].update(camera_model="OPENCV_FISHEYE", k1=-0.03, k2=0.01, k3=0.002, k4=0.001, p1=0.0, p2=0.0)
    data["frames"][3].update(k3=0.02)
    (root / "transforms.json").write_text(json.dumps(data))
    capture = recognise(root)
    np.testing.assert_array_equal(np.flatnonzero(capture.fisheye), [2])
    np.testing.assert_allclose(capture.distortion[2], [-0.03, 0.01, 0.002, 0.001, 0, 0, 0, 0])
    np.testing.assert_allclose(capture.distortion[3], [-0.06, 0.01, 0.001, -0.0005, 0.02, 0, 0, 0])


def test_what_is_said_of_lenses_that_cannot_be(colmap_capture, nerfstudio_capture, tmp_path):
    root = shutil.copytree(colmap_capture.root, tmp_path / "colmap")

    def colmap(line):
        (root / "sparse/0/cameras.txt").write_text(line + "\n")
        return root

    with pytest.raises(CaptureError, match=r"cameras\.txt: camera 1: model FOV is not supported .*image_undistorter"):
        recognise(colmap("1 FOV 80 64 70 70 40 32 0.9"))
    with pytest.raises(CaptureError, match=r"camera 1: 5 parameters, but OPENCV_FISHEYE has 8"):
        recognise(colmap("1 OPENCV_FISHEYE 80 64 70 70 40 32 0.1"))
    with pytest.raises(CaptureError, match=r"camera 1: parameter 4: not a finite number"):
        recognise(colmap("1 OPENCV_FISHEYE 80 64 70 70 40 32 nan 0 0 0"))
    with pytest.raises(CaptureError, match=r"images/000\.png: distortion: .*-9\.0.* fold the picture over"):
        run_frames(colmap("1 SIMPLE_RADIAL 80 64 70 40 32 -9"), tmp_path / "out")

    import pycolmap

    model = pycolmap.Reconstruction(str(colmap("1 FOV 80 64 70 70 40 32 0.9") / "sparse/0"))
    model.write_binary(str(root / "sparse/0"))
    with pytest.raises(CaptureError, match=r"cameras\.bin: camera 1: model FOV is not supported"):
        recognise(root)
    cameras = bytearray((root / "sparse/0/cameras.bin").read_bytes())
    cameras[12] = 99
    (root / "sparse/0/cameras.bin").write_bytes(cameras)
    with pytest.raises(CaptureError, match="model number 99 is not supported"):
        recognise(root)

    other = shutil.copytree(nerfstudio_capture.root, tmp_path / "nerfstudio")
    text = (other / "transforms.json").read_text()
    (other / "transforms.json").write_text(text.replace('"OPENCV"', '"EQUIRECTANGULAR"'))
    with pytest.raises(CaptureError, match=r"frame 0: camera_model: EQUIRECTANGULAR is not supported"):
        recognise(other)
