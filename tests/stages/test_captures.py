"""Each layout is recognised from its files, and its cameras, times, splits and pairs are the ones that made it."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from factory import Options, make, write_colmap, write_nerfstudio
from factory.writers import write_mp4
from PIL import Image


def edit(path, change):
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))


def assert_cameras(capture, truth):
    """Poses and K equal the truth, frame by frame, matched by file (files) or in order (videos)."""
    views = {(f"{file}#{view.time_index}" if capture.images is None else file): view for file, view in zip(truth.files, truth.views)}
    assert set(capture.names) == set(views)
    for i, name in enumerate(capture.names):
        camera = views[name].camera
        np.testing.assert_allclose(capture.cam_from_world[i], camera.cam_from_world, atol=1e-9)
        np.testing.assert_allclose(capture.K[i], camera.K, atol=1e-6)
        np.testing.assert_allclose(capture.distortion[i], camera.distortion, atol=1e-12)
        assert capture.time[i] == pytest.approx(views[name].time, abs=1e-6)


def test_dnerf_keeps_its_split_and_times(dnerf_capture):
    capture = recognise(dnerf_capture.root)
    facts = capture.facts
    assert (facts["format"], facts["splits"], facts["alpha"]) == ("dnerf", {"train": 12, "val": 2, "test": 4}, True)
    assert (facts["poses"], facts["pairs"], facts["cameras"], capture.background) == (True, 0, 18, "white")
    assert_cameras(capture, dnerf_capture)
    assert "transforms_val.json" in capture.files and "train/r_000.png" in capture.files


def test_n3v_rows_belong_to_sorted_cameras_and_cam00_is_test(n3v_capture):
    capture = recognise(n3v_capture.root)
    facts = capture.facts
    assert (facts["format"], facts["cameras"], facts["times"], facts["splits"]) == ("n3v", 4, 6, {"train": 18, "val": 0, "test": 6})
    assert facts["fixed_cameras"] and not facts["images_in_files"] and facts["pairs"] == 15
    assert_cameras(capture, n3v_capture)
    np.testing.assert_array_equal(capture.split[capture.camera == 0], 2)
    assert any("cam00.mp4 is held out for testing" in note and "frames.holdout=0" in note for note in capture.notes)
    whole = recognise(n3v_capture.root, holdout=0)
    assert whole.facts["splits"] == {"train": 24, "val": 0, "test": 0} and whole.facts["why"].endswith("all train")
    assert not any("held out" in note for note in whole.notes)


def test_n3v_focal_length_follows_the_size_of_the_video(n3v_capture, tmp_path):
    root = shutil.copytree(n3v_capture.root, tmp_path / "scaled")
    table = np.load(root / "poses_bounds.npy")
    table[:, [4, 9, 14]] *= 4  # h, w, f of the recording before it was scaled down
    np.save(root / "poses_bounds.npy", table)
    assert_cameras(recognise(root), n3v_capture)


def test_n3v_cameras_may_be_folders(n3v_capture, tmp_path):
    np.save(tmp_path / "poses_bounds.npy", np.load(n3v_capture.root / "poses_bounds.npy"))
    for camera in range(4):
        (tmp_path / f"cam{camera:02d}").mkdir()
        for t in range(3):
            Image.new("RGB", (80, 64)).save(tmp_path / f"cam{camera:02d}" / f"{t}.png")
    facts = recognise(tmp_path).facts
    assert (facts["format"], facts["frames"], facts["times"], facts["images_in_files"], facts["pairs"]) == ("n3v", 12, 3, True, 6)
    np.testing.assert_allclose(np.unique(recognise(tmp_path, every=2, fps=10).seconds), [0, 0.2], err_msg="as for a folder of images")


def test_panoptic(panoptic_capture):
    capture = recognise(panoptic_capture.root)
    facts = capture.facts
    assert (facts["format"], facts["splits"], facts["fixed_cameras"]) == ("panoptic", {"train": 12, "val": 0, "test": 4}, True)
    assert facts["pairs"] == 9 and facts["times"] == 4
    assert_cameras(capture, panoptic_capture)
    assert capture.masks[list(capture.images).index("ims/1/000000.jpg")] == "seg/1/000000.png"


def test_nerfstudio_holds_out_every_eighth_frame_and_keeps_distortion(nerfstudio_capture):
    capture = recognise(nerfstudio_capture.root)
    facts = capture.facts
    assert (facts["format"], facts["cameras"], facts["splits"]) == ("nerfstudio", 1, {"train": 8, "val": 0, "test": 2})
    np.testing.assert_array_equal(np.flatnonzero(capture.split == 2), [0, 8])
    assert_cameras(capture, nerfstudio_capture)


@pytest.mark.parametrize(("first", "last"), [(0, 0.06), (0, 0.5), (0, 0.9), (0.25, 1), (0.25, 0.75), (0, 1), (0, 1.5), (-3, 40)])
def test_times_of_the_files_are_rescaled_to_the_whole_unit_interval(nerfstudio_capture, tmp_path, first, last):
    """Motion and exports cover all of [0, 1]. Files may say i / N, or for frames cut from a longer video 0 to 0.06. Ten frames, 30 a
    second, last 0.3 s whatever the unit of their times."""
    root = shutil.copytree(nerfstudio_capture.root, tmp_path / "part")

    def retime(data):
        for i, frame in enumerate(data["frames"]):
            frame["time"] = first + (last - first) * i / (len(data["frames"]) - 1)

    edit(root / "transforms.json", retime)
    capture = recognise(root)
    np.testing.assert_allclose(capture.time, np.arange(10) / 9, atol=1e-12)
    assert (capture.time[0], capture.time[-1]) == (0, 1)
    np.testing.assert_allclose(recognise(root, fps=30).seconds, np.arange(10) / 30, atol=1e-12)


def test_times_are_rescaled_for_all_splits_together(dnerf_capture, tmp_path):
    """Training frames that end before the test frames stay before them."""
    root = shutil.copytree(dnerf_capture.root, tmp_path / "later")
    for split, shift in (("train", 0.0), ("val", 0.1), ("test", 0.2)):
        edit(root / f"transforms_{split}.json", lambda data, shift=shift: [f.update(time=0.7 * f["time"] + shift) for f in data["frames"]])
    before, after = recognise(dnerf_capture.root), recognise(root)
    raw = 0.7 * before.time + np.array([0.0, 0.1, 0.2])[before.split]
    np.testing.assert_allclose(after.time, (raw - raw.min()) / np.ptp(raw), atol=1e-12)
    assert (after.time.min(), after.time.max()) == (0, 1)


def test_pairs_never_touch_held_out_frames(nerfstudio_capture):
    capture = recognise(nerfstudio_capture.root)
    np.testing.assert_array_equal(capture.next, [-1, 2, 3, 4, 5, 6, 7, 9, -1, -1])
    assert capture.facts["pairs"] == 7
    np.testing.assert_array_equal(recognise(nerfstudio_capture.root, holdout=0).next, [1, 2, 3, 4, 5, 6, 7, 8, 9, -1])


@pytest.mark.parametrize(("count", "holdout", "test"), [(2, 8, 0), (3, 8, 0), (4, 8, 1), (8, 8, 1), (9, 8, 2), (3, 2, 2)])
def test_few_pictures_are_all_trained_on(tmp_path, count, holdout, test):
    """The first frame would be held out of any number, of two pictures half."""
    for k in range(count):
        Image.new("RGB", (8, 8), (k, 0, 0)).save(tmp_path / f"{k}.png")
    assert recognise(tmp_path, holdout=holdout).facts["splits"] == {"train": count - test, "val": 0, "test": test}


def test_nerfstudio_filenames_of_splits_win_over_the_hold_out(nerfstudio_capture, tmp_path):
    root = shutil.copytree(nerfstudio_capture.root, tmp_path / "split")

    def split(data):
        names = [f["file_path"] for f in data["frames"]]
        data.update(train_filenames=names[:6], val_filenames=names[6:7], test_filenames=names[7:])

    edit(root / "transforms.json", split)
    capture = recognise(root)
    np.testing.assert_array_equal(capture.split, [0] * 6 + [1] + [2] * 3)
    assert not any("train_filenames" in note for note in capture.notes)

    def overlap(data):
        names = [f["file_path"] for f in data["frames"]]
        data.update(train_filenames=names[:8], val_filenames=names[6:], test_filenames=names[6:])

    edit(root / "transforms.json", overlap)
    capture = recognise(root)
    np.testing.assert_array_equal(capture.split, [0] * 6 + [2] * 4)
    (note,) = [note for note in capture.notes if "train_filenames" in note]
    assert note.startswith("2 of 10 frames of transforms.json are in train_filenames and in a list that is held out; they are held out")


def test_a_second_list_of_test_frames_is_held_out_and_bad_frames_are_left_out(nerfstudio_capture, tmp_path):
    """As in ScanNet++."""
    root = shutil.copytree(nerfstudio_capture.root, tmp_path / "scannetpp")

    def move(data):
        data["test_frames"], data["frames"] = data["frames"][7:], data["frames"][:7]
        data["frames"][2]["is_bad"], data["test_frames"][1]["is_bad"], data["frames"][3]["is_bad"] = True, True, False

    edit(root / "transforms.json", move)
    capture = recognise(root)
    np.testing.assert_array_equal(capture.split, [0] * 6 + [2] * 2)
    assert any("2 of 10 frames of transforms.json are marked is_bad and are left out; first" in note for note in capture.notes)
    edit(root / "transforms.json", lambda data: data["test_frames"][2].pop("transform_matrix"))
    with pytest.raises(CaptureError, match=r"test_frames\[2\]: transform_matrix"):
        recognise(root)


def test_nerfstudio_order_without_times_is_that_of_the_names(nerfstudio_capture, tmp_path):
    root = shutil.copytree(nerfstudio_capture.root, tmp_path / "untimed")

    def shuffle(data):
        data["frames"].reverse()
        for frame in data["frames"]:
            del frame["time"]

    edit(root / "transforms.json", shuffle)
    capture = recognise(root)
    assert capture.names[:2] == ("images/000.png", "images/001.png")
    np.testing.assert_allclose(capture.time, np.arange(10) / 9)
    assert_cameras(capture, nerfstudio_capture)


def test_nerfstudio_with_repeated_times_is_several_cameras(nerfstudio_capture, tmp_path):
    """Five frames at each of two times: tripods when poses repeat, single cameras without pairs when they do not."""
    root = shutil.copytree(nerfstudio_capture.root, tmp_path / "many")

    def two_times(data):
        for i, frame in enumerate(data["frames"]):
            frame["time"] = float(i >= 5)

    edit(root / "transforms.json", two_times)
    facts = recognise(root).facts
    assert (facts["cameras"], facts["times"], facts["pairs"], facts["fixed_cameras"]) == (10, 2, 0, False)

    def tripods(data):
        for i in range(5):
            data["frames"][5 + i]["transform_matrix"] = data["frames"][i]["transform_matrix"]

    edit(root / "transforms.json", tripods)
    facts = recognise(root, holdout=0).facts
    assert (facts["cameras"], facts["times"], facts["pairs"], facts["fixed_cameras"]) == (5, 2, 5, True)


@pytest.fixture
def tripods(tmp_path):
    """Five fixed cameras at each of four times, in one transforms.json: image 5 t + c shows time t / 3 from camera c."""
    options = Options(backdrop="room", rig="arc", cameras=5, times=4, width=32, height=24, samples=1)
    root = write_nerfstudio(make(options), tmp_path / "tripods").root
    edit(root / "transforms.json", lambda data: data["frames"].sort(key=lambda f: f["time"]))
    return root


@pytest.mark.parametrize("gone", [1, 7])
def test_fixed_cameras_may_lack_pictures(tripods, gone):
    truth = recognise(tripods)
    for name in (truth.images[k] for k in (6, 9, 12, 13, 0, 19, 3)[:gone]):
        (tripods / name).unlink()
    capture = recognise(tripods)
    facts = capture.facts
    assert (facts["cameras"], facts["times"], facts["frames"], facts["fixed_cameras"]) == (5, 4, 20 - gone, True)
    camera = dict(zip(truth.names, truth.camera.tolist()))
    assert len({(camera[name], mine) for name, mine in zip(capture.names, capture.camera.tolist())}) == 5
    assert f"{gone} of 20 frames of transforms.json have no image" in capture.notes[0]


def test_fixed_cameras_are_seen_at_several_times_and_once_at_each(tripods):
    """Views of one time only, as D-NeRF has them, are cameras of their own. So are two pictures of one camera at one time, unless their
    folders tell two cameras apart."""
    frames = json.loads((tripods / "transforms.json").read_text())["frames"]

    def alike(data):
        data["frames"][1::5] = [{**f, "transform_matrix": frames[0]["transform_matrix"]} for f in data["frames"][1::5]]

    edit(tripods / "transforms.json", alike)
    assert (recognise(tripods).facts["cameras"], recognise(tripods).facts["fixed_cameras"]) == (20, False)

    def sort_into_folders(data):
        for k, frame in enumerate(data["frames"]):
            new = f"cam{k % 5}/{k // 5}.png"
            (tripods / new).parent.mkdir(exist_ok=True)
            shutil.move(tripods / frame["file_path"], tripods / new)
            frame["file_path"] = new

    edit(tripods / "transforms.json", sort_into_folders)
    capture = recognise(tripods)
    assert (capture.facts["cameras"], capture.facts["fixed_cameras"]) == (5, True)
    assert len({(name.split("/")[0], camera) for name, camera in zip(capture.names, capture.camera.tolist())}) == 5

    def step_aside(data):
        data["frames"][2]["transform_matrix"] = (np.array(data["frames"][2]["transform_matrix"]) + np.eye(4, k=3) * 0.1).tolist()

    edit(tripods / "transforms.json", step_aside)
    assert (recognise(tripods).facts["cameras"], recognise(tripods).facts["fixed_cameras"]) == (5, False)


def test_intrinsics_per_frame_and_size_in_the_file(nerfstudio_capture, tmp_path):
    root = shutil.copytree(nerfstudio_capture.root, tmp_path / "own")

    def own(data):
        data["frames"][3]["fl_x"] = 123.0
        data.update(w=160, h=128)  # calibrated at twice the size

    edit(root / "transforms.json", own)
    capture, before = recognise(root), recognise(nerfstudio_capture.root)
    assert capture.K[3, 0, 0] == pytest.approx(61.5)
    np.testing.assert_allclose(capture.K[4, :2], before.K[4, :2] / 2)


def test_colmap_text_model(colmap_capture):
    capture = recognise(colmap_capture.root)
    facts = capture.facts
    assert (facts["format"], facts["frames"], facts["points"], facts["poses"]) == ("colmap", 8, True, True)
    assert capture.points.shape == (200, 3) and capture.point_colors.dtype == np.uint8
    assert_cameras(capture, colmap_capture)


def test_colmap_binary_model_equals_the_text(colmap_capture, tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    root = tmp_path / "binary"
    shutil.copytree(colmap_capture.root / "images", root / "images")
    (root / "sparse/0").mkdir(parents=True)
    pycolmap.Reconstruction(str(colmap_capture.root / "sparse/0")).write_binary(str(root / "sparse/0"))
    assert not (root / "sparse/0/cameras.txt").exists()
    capture = recognise(root)
    assert_cameras(capture, colmap_capture)
    order = np.lexsort(capture.points.T)
    text = recognise(colmap_capture.root).points
    np.testing.assert_allclose(capture.points[order], text[np.lexsort(text.T)], atol=1e-9)


@pytest.mark.parametrize("binary", [False, True])
def test_colmap_model_of_several_cameras(tmp_path, binary):
    """Three lenses, two sizes, and a camera that no image uses; each image keeps its own."""
    options = Options(backdrop="room", rig="path", times=6, sizes=((80, 64), (80, 64), (160, 128)), samples=1)
    synthetic = make(options)
    views = tuple(
        replace(
            v,
            camera=replace(v.camera, K=v.camera.K * [[1.2], [1.2], [1]], distortion=(-0.05, 0, 0, 0))
            if v.time_index % 3 == 1
            else v.camera,
        )
        for v in synthetic.views
    )
    truth = write_colmap(replace(synthetic, views=views), tmp_path / "capture")
    sparse = truth.root / "sparse/0"
    with (sparse / "cameras.txt").open("a") as file:
        file.write("9 FOV 80 64 70 70 40 32 0.9\n" if not binary else "9 PINHOLE 8 6 70 70 4 3\n")
    if binary:
        pycolmap = pytest.importorskip("pycolmap")
        model = pycolmap.Reconstruction(str(sparse))
        for file in sparse.glob("*.txt"):
            file.unlink()
        model.write_binary(str(sparse))
    capture = recognise(truth.root)
    assert len({tuple(K.ravel()) for K in capture.K}) == 2 and (capture.facts["width"], capture.facts["height"]) == (80, 64)
    for i, view in enumerate(truth.views):
        shrunk = np.diag([80 / view.camera.width, 64 / view.camera.height, 1]) @ view.camera.K
        np.testing.assert_allclose(capture.K[i], shrunk, atol=1e-9)
        np.testing.assert_allclose(capture.distortion[i], view.camera.distortion)
        np.testing.assert_allclose(capture.cam_from_world[i], view.camera.cam_from_world, atol=1e-9)


def test_folder_of_images_is_one_camera_over_time(images_capture):
    capture = recognise(images_capture.root)
    facts = capture.facts
    assert (facts["format"], facts["poses"], facts["static"], facts["cameras"]) == ("images", False, False, 1)
    assert facts["splits"] == {"train": 8, "val": 0, "test": 2} and facts["pairs"] == 7
    assert capture.K is None and capture.seconds[-1] == pytest.approx(9 / 30)
    third = recognise(images_capture.root, every=3, fps=25)
    np.testing.assert_allclose(third.seconds, np.arange(0, 10, 3) / 25, err_msg="images that are not taken have had their time, too")


def assumed(capture):
    return sum("no file says how fast" in note and "30 a second" in note and "--set frames.fps=" in note for note in capture.notes)


def test_a_rate_that_no_file_states_is_told(images_capture, colmap_capture, nerfstudio_capture, dnerf_capture, n3v_capture, tmp_path):
    """Where times differ, and are more than shares of the whole. With a rate, pictures that are missing have had their time."""
    for root in (images_capture.root, colmap_capture.root, nerfstudio_capture.root):
        assert (assumed(recognise(root)), assumed(recognise(root, static=True)), assumed(recognise(root, fps=24))) == (1, 0, 0), root
    assert not assumed(recognise(dnerf_capture.root)) and not assumed(recognise(n3v_capture.root))
    own = shutil.copytree(nerfstudio_capture.root, tmp_path / "own")
    edit(own / "transforms.json", lambda data: data.update(fps=24))
    assert not assumed(recognise(own))
    gone = shutil.copytree(colmap_capture.root, tmp_path / "gone")
    before = recognise(gone, fps=10)
    (gone / before.images[3]).unlink()
    after = recognise(gone, fps=10)
    np.testing.assert_allclose(after.seconds, np.delete(before.seconds, 3))


def test_images_sort_naturally_and_other_files_are_ignored(tmp_path):
    folder = tmp_path / "images"
    folder.mkdir()
    for name in ("10.png", "9.PNG", "2.png", ".hidden.png"):
        Image.new("RGB", (20, 10)).save(folder / name, format="png")
    (folder / "notes.md").write_text("words")
    (folder / "K.txt").write_text("30 0 10\n0 30 5\n0 0 1\n")
    (tmp_path / "Readme.txt").write_text("words")
    capture = recognise(tmp_path)
    assert capture.names == ("images/2.png", "images/9.PNG", "images/10.png")
    assert capture.K_hint == (30, 0, 10, 0, 30, 5, 0, 0, 1)
    assert "images/K.txt" in capture.files and "images/notes.md" not in capture.files


def test_other_folders_beside_images_count_only_if_they_hold_pictures(tmp_path):
    """A workspace made by a run in the capture's own folder, and what macOS packs into archives, may lie there."""
    root = tmp_path / "room"
    for i in range(3):
        (root / "images").mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (20, 10)).save(root / f"images/{i}.png")
    for folder in ("e4dgs-workspace/store", "e4dgs-workspace/scenes", "__MACOSX/images", ".cache", "notes/later"):
        (root / folder).mkdir(parents=True)
    for stray in ("e4dgs-workspace/turntable.png", "__MACOSX/0.png", ".cache/0.png", "notes/later/0.png"):
        shutil.copy(root / "images/0.png", root / stray)
    assert recognise(root).names == ("images/0.png", "images/1.png", "images/2.png")
    shutil.copy(root / "images/0.png", root / "notes/0.png")
    with pytest.raises(CaptureError, match=r"nothing recognised here\. It has the folders images, notes: pass the one"):
        recognise(root)


def test_static_collapses_times(images_capture):
    capture = recognise(images_capture.root, static=True)
    assert capture.facts["static"] and capture.facts["times"] == 1 and capture.facts["pairs"] == 0
    assert not capture.time.any() and (capture.next == -1).all()


def test_video(video_capture):
    capture = recognise(video_capture.root)
    facts = capture.facts
    assert (facts["format"], facts["frames"], facts["width"], facts["height"]) == ("video", 12, 96, 80)
    assert (facts["images_in_files"], facts["poses"], capture.files) == (False, False, ("clip.mp4",))
    step = 1 / round(video_capture.synthetic.options.fps)
    np.testing.assert_allclose(capture.seconds, np.arange(12) * step, atol=1e-6)
    assert recognise(video_capture.root.parent).facts == facts, "a folder that holds one video means the video"


def test_video_frames_are_thinned_and_it_is_said(video_capture):
    assert recognise(video_capture.root, every=5).names == ("clip.mp4#0", "clip.mp4#5", "clip.mp4#10")
    capture = recognise(video_capture.root, max_frames=5)
    assert capture.facts["frames"] == 4 and "4 of 12" in capture.notes[0]


@pytest.mark.parametrize(("frames", "static", "taken"), [(600, False, 600), (601, False, 301), (600, True, 200), (601, True, 151)])
def test_a_clip_in_which_things_move_keeps_more_frames(frames, static, taken, tmp_path):
    grey = np.random.default_rng(0).integers(0, 255, (32, 32, 3)).astype(np.uint8)
    write_mp4(tmp_path / "clip.mp4", (grey for _ in range(frames)), 30.0)
    assert recognise(tmp_path / "clip.mp4", static=static).facts["frames"] == taken


def test_max_size_scales_intrinsics(nerfstudio_capture, images_capture):
    before, after = recognise(nerfstudio_capture.root), recognise(nerfstudio_capture.root, max_size=40)
    assert (after.facts["width"], after.facts["height"]) == (40, 32)
    np.testing.assert_allclose(after.K[:, :2], before.K[:, :2] / 2)
    assert recognise(images_capture.root, max_size=1000).facts["width"] == 96, "nothing is enlarged"


def test_times_outside_the_unit_interval_are_stretched_over_the_capture(dnerf_capture, tmp_path):
    root = shutil.copytree(dnerf_capture.root, tmp_path / "seconds")
    original = recognise(dnerf_capture.root)
    for split in ("train", "val", "test"):
        edit(root / f"transforms_{split}.json", lambda data: [f.update(time=10 + 4 * f["time"]) for f in data["frames"]])
    low, high = original.time.min(), original.time.max()
    np.testing.assert_allclose(recognise(root).time, (original.time - low) / (high - low), atol=1e-12)


def test_smooth_path_in_the_dnerf_layout_is_one_camera(tmp_path):
    """A walk of 20 frames makes pairs, except over its cut; the same views in random order do not."""
    rng = np.random.default_rng(0)
    centres = np.stack([np.linspace(0, 4, 20), np.zeros(20), np.zeros(20)], 1)
    centres[10:] += [5, 0, 0]

    def write(root, order):
        root.mkdir()
        frames = []
        for t, k in enumerate(order):
            pose = np.eye(4)
            pose[:3, 3] = centres[k]
            frames.append({"file_path": f"{t}", "time": t / 19, "transform_matrix": pose.tolist()})
            Image.new("RGB", (8, 8)).save(root / f"{t}.png")
        data = {"camera_angle_x": 1.0, "frames": frames[:-1]}
        (root / "transforms_train.json").write_text(json.dumps(data))
        (root / "transforms_test.json").write_text(json.dumps({**data, "frames": frames[-1:]}))
        return recognise(root)

    walk = write(tmp_path / "walk", range(20))
    assert walk.facts["pairs"] == 17 and walk.facts["cameras"] == 2 and walk.next[9] == -1 and walk.next[8] == 9
    scattered = write(tmp_path / "scattered", rng.permutation(20))
    assert scattered.facts["pairs"] == 0 and scattered.facts["cameras"] == 20


def test_recognition_imports_nothing_heavy(dnerf_capture):
    code = (
        "import sys; from e4dgs.stages.frames.stage import FramesSettings, recognise_for;"
        f"recognise_for({str(dnerf_capture.root)!r}, FramesSettings());"
        "print([m for m in ('torch', 'cv2', 'scipy', 'pycolmap', 'zarr') if m in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"


def test_a_folder_that_fits_two_formats_names_both(nerfstudio_capture, dnerf_capture, tmp_path):
    root = shutil.copytree(dnerf_capture.root, tmp_path / "both")
    shutil.copytree(nerfstudio_capture.root, root, dirs_exist_ok=True)
    with pytest.raises(CaptureError, match=r"dnerf .*nerfstudio .*--format dnerf or --format nerfstudio"):
        recognise(root)
    assert recognise(root, format="nerfstudio").facts["format"] == "nerfstudio"
    assert recognise(root, format="dnerf").facts["format"] == "dnerf"


@pytest.mark.parametrize(
    ("path", "options", "expected"),
    [
        ("lego", {}, {"format": "dnerf", "splits": {"train": 50, "val": 11, "test": 20}, "pairs": 0}),
        ("robot", {}, {"format": "dnerf", "splits": {"train": 100, "val": 10, "test": 20}, "pairs": 0}),
        ("room_mono", {}, {"format": "dnerf", "splits": {"train": 90, "val": 0, "test": 12}, "pairs": 89, "cameras": 13}),
        ("room_video/room.mp4", {}, {"format": "video", "frames": 90, "poses": False}),
        ("balloon1", {}, {"format": "nerfstudio", "splits": {"train": 10, "val": 0, "test": 2}, "cameras": 1}),
        ("balloon1/images", {}, {"format": "images", "frames": 12}),
        ("sceaux/images", {"static": True}, {"format": "images", "frames": 11, "static": True, "pairs": 0}),
        ("basketball", {}, {"format": "panoptic", "splits": {"train": 324, "val": 0, "test": 48}, "fixed_cameras": True}),
        ("stage", {}, {"format": "n3v", "splits": {"train": 315, "val": 0, "test": 45}, "fixed_cameras": True}),
    ],
)
def test_real_captures(shared_scenes, path, options, expected):
    facts = recognise(Path(shared_scenes) / path, **options).facts
    assert {key: facts[key] for key in expected} == expected


def stamped(root, values, time=False):
    """A nerfstudio capture whose frames have these time stamps, None for none, in reverse order of their names."""
    path = root / "transforms.json"
    data = json.loads(path.read_text())
    data["frames"] = sorted(data["frames"], key=lambda frame: frame["file_path"])[: len(values)]
    for frame, value in zip(data["frames"], values[::-1], strict=True):
        frame |= {} if value is None else {"timestamp": value}
        if not time:
            frame.pop("time", None)
    path.write_text(json.dumps(data))
    return recognise(root, holdout=0)


BEGAN = 1_700_000_000_000_000_000
STAMPS = {
    "seconds": ([100.5, 100.75, 101.0, 102.5], [0, 0.25, 0.5, 2], "in seconds"),
    "whole seconds": ([0, 1, 3, 4], [0, 1, 3, 4], "in seconds"),
    "nanoseconds": ([BEGAN, BEGAN + 50_000_001, BEGAN + 10**8, BEGAN + 3 * 10**8], [0, 0.050000001, 0.1, 0.3], "in nanoseconds"),
    "an unknown unit": ([0, 33, 66, 132], None, "in an unknown unit"),
}


@pytest.mark.parametrize("case", STAMPS)
def test_time_stamps_of_nerfstudio_are_times_if_there_are_no_others(nerfstudio_capture, tmp_path, case):
    values, seconds, words = STAMPS[case]
    capture = stamped(shutil.copytree(nerfstudio_capture.root, tmp_path / "c"), values)
    span = values[-1] - values[0]
    np.testing.assert_allclose(capture.time, [(value - values[0]) / span for value in values], atol=1e-12)
    assert [name[-7:-4] for name in capture.names] == ["003", "002", "001", "000"]
    if seconds is not None:
        np.testing.assert_allclose(capture.seconds, seconds, rtol=0, atol=1e-12)
    assert any(f"the frames have no time; their timestamp is read, {words}" in note for note in capture.notes)


UNREAD_STAMPS = {
    "some": ([0.5, None, 1.5, 2.0], "frame 2 has none"),
    "text": ([0.5, "2024-05-01", 1.5, 2.0], "frame 2 has '2024-05-01', no number"),
    "not a number": ([0.5, float("nan"), 1.5, 2.0], "frame 2 has 'nan', no number"),
    "too large": ([0.5, 10**400, 1.5, 2.0], "no number"),
    "equal": ([3, 3, 3, 3], "all are equal"),
}


@pytest.mark.parametrize("case", UNREAD_STAMPS)
def test_time_stamps_that_are_no_times_are_told(nerfstudio_capture, tmp_path, case):
    values, words = UNREAD_STAMPS[case]
    capture = stamped(shutil.copytree(nerfstudio_capture.root, tmp_path / "c"), values)
    assert [name[-7:-4] for name in capture.names] == ["000", "001", "002", "003"]
    (line,) = [note for note in capture.notes if "timestamp" in note]
    assert "timestamp of the frames is not read, because" in line and words in line


def test_times_come_before_time_stamps(nerfstudio_capture, tmp_path):
    root = shutil.copytree(nerfstudio_capture.root, tmp_path / "c")
    expected = recognise(root, holdout=0)
    capture = stamped(root, [float(i) for i in range(len(expected.names))], time=True)
    assert capture.names == expected.names and (capture.time == expected.time).all()
    assert any("timestamp of the frames is not read, because they have a time as well" in note for note in capture.notes)
