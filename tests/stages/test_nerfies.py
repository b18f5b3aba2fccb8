"""The layout of Nerfies and HyperNeRF: cameras, times and splits are those that made it, and each broken file is one message."""

import json
import shutil

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from e4dgs.stages.shared.frameset import FrameSet
from factory import Camera, Options, make, render, surface_points, write_nerfies
from factory.writers import flatten
from run_stage import run_frames


@pytest.fixture
def broken(nerfies_capture, tmp_path):
    """`broken(file, change)` is a copy of the capture in which `change` was applied to a JSON file."""

    def change(file, change):
        root = tmp_path / "capture"
        shutil.rmtree(root, ignore_errors=True)
        shutil.copytree(nerfies_capture.root, root)
        if change is not None:
            data = json.loads((root / file).read_text())
            (root / file).write_text(json.dumps(change(data) or data))
        return root

    return change


def test_cameras_times_and_splits(nerfies_capture):
    capture = recognise(nerfies_capture.root)
    facts = capture.facts
    assert (facts["format"], facts["frames"], facts["cameras"], facts["times"], facts["points"]) == ("nerfies", 9, 1, 9, True)
    assert facts["splits"] == {"train": 6, "val": 3, "test": 0} and facts["pairs"] == 5 and not facts["fixed_cameras"]
    np.testing.assert_array_equal(np.flatnonzero(capture.split == 1), [1, 4, 7])
    assert capture.images == nerfies_capture.files
    for i, view in enumerate(nerfies_capture.views):
        np.testing.assert_allclose(capture.cam_from_world[i], view.camera.cam_from_world, atol=1e-9)
        np.testing.assert_allclose(capture.K[i], view.camera.K, atol=1e-9)
        np.testing.assert_allclose(capture.distortion[i], [-0.06, 0.01, 0.001, -0.0005, 0.02, 0, 0, 0])
        assert capture.time[i] == pytest.approx(view.time)
    np.testing.assert_allclose(capture.points, surface_points(nerfies_capture.synthetic, 200)[0], atol=1e-9)
    assert {"dataset.json", "metadata.json", "scene.json", "points.npy", "camera/0_000004.json"} <= set(capture.files)


def test_two_cameras_of_a_validation_rig(tmp_path):
    """Both see each time; one trains, the other is held out."""
    capture = write_nerfies(make(Options(backdrop="room", rig="arc", cameras=2, times=4, samples=1)), tmp_path)
    facts = recognise(capture.root).facts
    assert (facts["cameras"], facts["times"], facts["splits"], facts["pairs"]) == (2, 4, {"train": 4, "val": 4, "test": 0}, 3)


def test_pictures_equal_renders(nerfies_capture, tmp_path):
    ran = run_frames(nerfies_capture.root, tmp_path)
    frames = FrameSet(ran.artifact, nerfies_capture.root)
    view = nerfies_capture.views[4]
    truth = flatten(render(nerfies_capture.synthetic.scene, Camera(frames.K[4], view.camera.cam_from_world, 80, 64), view.time, 4)).astype(
        float
    )
    error, moved = (np.square(p - truth).mean() for p in (frames.image(4).astype(float), np.roll(frames.image(4), 1, 1)))
    assert 10 * np.log10(255**2 / error) > 24 and error < moved / 3


@pytest.mark.parametrize(("max_size", "folder"), [(None, "rgb/1x"), (80, "rgb/1x"), (60, "rgb/1x"), (40, "rgb/2x"), (20, "rgb/2x")])
def test_the_coarsest_pictures_that_suffice_are_read(nerfies_capture, max_size, folder):
    capture = recognise(nerfies_capture.root, max_size=max_size)
    assert capture.images[0].startswith(folder)
    width = capture.facts["width"]
    assert width == (max_size or 80)
    np.testing.assert_allclose(capture.K[3][:2], nerfies_capture.views[3].camera.K[:2] * width / 80)


def test_hypernerf_says_time_id_and_older_cameras_say_tangential(broken, nerfies_capture):
    def time_ids(data):
        for entry in data.values():
            entry.update(time_id=2 * entry["warp_id"], warp_id=0)

    root = broken("metadata.json", time_ids)
    for file in (root / "camera").iterdir():
        file.write_text(file.read_text().replace("tangential_distortion", "tangential"))
    found, before = recognise(root), recognise(nerfies_capture.root)
    np.testing.assert_allclose(found.time, before.time)
    np.testing.assert_allclose(found.distortion, before.distortion)


def test_without_metadata_scene_and_points(broken, nerfies_capture):
    root = broken("dataset.json", lambda data: data.update(val_ids=[]))
    for name in ("metadata.json", "scene.json", "points.npy"):
        (root / name).unlink()
    found = recognise(root)
    assert found.facts["splits"] == {"train": 5, "val": 0, "test": 1} and found.points is None
    centre = json.loads((root / "camera/0_000000.json").read_text())["position"]
    np.testing.assert_allclose(-found.cam_from_world[0, :3, :3].T @ found.cam_from_world[0, :3, 3], centre)


CAMERA = "camera/0_000003.json"
BAD = {
    "no train ids": ("dataset.json", lambda d: d.pop("train_ids") and None, "dataset.json: train_ids"),
    "id that leads away": (
        "dataset.json",
        lambda d: d["train_ids"].__setitem__(2, "../../etc"),
        "train_ids[2]: '../../etc' is not a file name",
    ),
    "id of no kind": ("dataset.json", lambda d: d["train_ids"].__setitem__(2, None), "train_ids[2]: expected a non-empty string"),
    "id in both": ("dataset.json", lambda d: d["val_ids"].append(d["train_ids"][0]), "val_ids[3]: '0_000000' is listed twice"),
    "id without image": ("dataset.json", lambda d: d["train_ids"].append("nothing"), "'nothing'"),
    "id without metadata": ("metadata.json", lambda d: d.pop("0_000003") and None, "metadata.json: '0_000003': expected an object"),
    "no time": ("metadata.json", lambda d: d["0_000003"].pop("warp_id") and None, "metadata.json: '0_000003': warp_id is missing"),
    "time NaN": ("metadata.json", lambda d: d["0_000003"].update(warp_id=float("nan")), "metadata.json: '0_000003': warp_id: not a finite"),
    "camera id": ("metadata.json", lambda d: d["0_000003"].update(camera_id="left"), "'0_000003': camera_id: expected a number"),
    "scale zero": ("scene.json", lambda d: d.update(scale=0), "scene.json: scale: 0 lies outside"),
    "center short": ("scene.json", lambda d: d.update(center=[1, 2]), "scene.json: center: expected a list of 3 numbers, found 2"),
    "orientation": (CAMERA, lambda d: d["orientation"][0].__setitem__(0, 9), f"{CAMERA}: orientation: the 3x3 part"),
    "position Inf": (CAMERA, lambda d: d["position"].__setitem__(1, float("inf")), f"{CAMERA}: position[1]: not a finite number"),
    "focal length": (CAMERA, lambda d: d.update(focal_length=0), f"{CAMERA}: focal_length: 0 lies outside"),
    "no focal length": (CAMERA, lambda d: d.pop("focal_length") and None, f"{CAMERA}: focal_length: expected a number"),
    "skew": (CAMERA, lambda d: d.update(skew=5.0), f"{CAMERA}: skew 5 is not supported"),
    "radial": (CAMERA, lambda d: d.update(radial_distortion=[0, 0, 1e9]), f"{CAMERA}: radial_distortion[2]: 1e+09 lies outside"),
    "image size": (CAMERA, lambda d: d.update(image_size=[64, 80]), f"{CAMERA}: image_size says 64x80, but rgb/1x/0_000003.png is 80x64"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_files_are_one_message(broken, case):
    file, change, word = BAD[case]
    with pytest.raises(CaptureError) as caught:
        recognise(broken(file, change))
    message = str(caught.value)
    assert word in message and "\n" not in message and len(message) < 500, message


def test_missing_files_are_named(broken):
    root = broken(None, None)
    (root / CAMERA).unlink()
    with pytest.raises(CaptureError, match=r"camera/0_000003\.json: missing, but dataset\.json lists '0_000003'"):
        recognise(root)
    root = broken(None, None)
    shutil.rmtree(root / "rgb")
    with pytest.raises(CaptureError, match="no rgb/1x, rgb/2x"):
        recognise(root)
    root = broken(None, None)
    np.save(root / "points.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(CaptureError, match=r"points\.npy: not a readable numpy array"):
        recognise(root)
    np.save(root / "points.npy", np.array([[0, 0, 0], [0, np.nan, 0]]))
    with pytest.raises(CaptureError, match=r"points\.npy: point 1: .* is not a valid position"):
        recognise(root)
