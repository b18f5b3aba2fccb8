"""LLFF, 4DGaussians, Record3D, Polycam, 7-Scenes and TUM: poses, times and lenses are those that made them."""

import importlib
import importlib.util
import json
import shutil

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import FORMATS, recognise
from e4dgs.stages.shared.frameset import FrameSet
from factory import Options, make
from factory.scans import llff_row, write_llff, write_multiview, write_polycam, write_record3d, write_rgbd, write_stray, write_tum
from PIL import Image
from run_stage import run_frames
from scipy.spatial.transform import Rotation

PATH = Options(backdrop="room", rig="path", times=12, width=40, height=32, samples=1, fov_degrees=60.0)
RIG = Options(backdrop="room", rig="arc", cameras=11, times=2, width=40, height=32, samples=1, fov_degrees=60.0)


def assert_truth(capture, written, atol=1e-8):
    views = dict(zip(written.files, written.views, strict=True))
    assert set(capture.names) == set(views)
    for i, name in enumerate(capture.names):
        np.testing.assert_allclose(capture.cam_from_world[i], views[name].camera.cam_from_world, atol=atol)
        np.testing.assert_allclose(capture.K[i], views[name].camera.K, atol=1e-6)
        assert capture.time[i] == pytest.approx(views[name].time, abs=1e-5)


def refused(root, *words, **options):
    with pytest.raises(CaptureError) as caught:
        recognise(root, **options)
    assert all(word in str(caught.value) for word in words), str(caught.value)


@pytest.fixture(scope="module")
def path():
    return make(PATH)


@pytest.mark.parametrize("name", ["IMG_{:04d}.png", "{}.png"])
def test_llff_rows_belong_to_pictures_in_plain_order(path, tmp_path, name):
    """Names without zeros: rows in the order 0, 1, 10, 11, 2, ..., time in the order of the numbers, and every eighth row is test."""
    written = write_llff(path, tmp_path, name)
    capture = recognise(tmp_path)
    assert (capture.facts["format"], capture.facts["untimed"], capture.facts["cameras"]) == ("llff", True, 1)
    assert_truth(capture, written)
    plain = sorted(written.files)
    assert [n for n, split in zip(capture.names, capture.split, strict=True) if split == 2] == plain[::8]
    assert any("plain order" in note and "images/1" not in note for note in capture.notes) is (name == "{}.png")
    assert recognise(tmp_path, static=True).facts["static"]


def test_llff_takes_copies_by_the_size_that_is_asked_for(path, tmp_path):
    write_llff(path, tmp_path)
    shutil.copytree(tmp_path / "images", tmp_path / "images_4")
    for file in (tmp_path / "images_4").iterdir():
        Image.open(file).resize((20, 16)).save(file)
    full, small = recognise(tmp_path), recognise(tmp_path, max_size=20)
    assert (full.images[0], small.images[0]) == ("images/IMG_0000.png", "images_4/IMG_0000.png")
    np.testing.assert_allclose(small.K[0][:2], full.K[0][:2] / 2)
    assert any("images_4" in note and "not read" in note for note in full.notes)
    np.save(tmp_path / "poses_bounds.npy", np.load(tmp_path / "poses_bounds.npy")[:7])
    refused(tmp_path, "poses_bounds.npy: 7 rows for 12 pictures")


@pytest.mark.parametrize("model", [True, False])
def test_multiview_of_4dgaussians(tmp_path, model):
    """With the model, image10 is cam10; without it, rows are in the plain order of the cameras, and a note says so."""
    written = write_multiview(make(RIG), tmp_path, model)
    capture = recognise(tmp_path)
    assert (capture.facts["format"], capture.facts["cameras"], capture.facts["times"]) == ("n3v", 11, 2)
    assert_truth(capture, written)
    np.testing.assert_array_equal(capture.split[capture.camera == 0], 2)
    assert any("poses_bounds_multipleview.npy" in note and ("not read" in note) is model for note in capture.notes)


@pytest.mark.parametrize("images", [False, True])
def test_videos_of_a_rig_may_have_the_names_of_the_images_of_the_model(n3v_capture, tmp_path, images):
    """Of action cameras, say; with the pictures beside the model or without."""
    views = {view.camera_index: view for view in n3v_capture.views}
    rows = ["1 PINHOLE 80 64 " + " ".join(str(views[0].camera.K[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))]
    names = dict(zip(sorted(views), ("GX010034", "left", "A", "GX020035"), strict=True))
    posed = []
    for k, name in names.items():
        shutil.copy(n3v_capture.root / f"cam{k:02d}.mp4", tmp_path / f"{name}.MP4")
        pose = views[k].camera.cam_from_world
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        posed.append(f"{k + 1} {w} {x} {y} {z} {' '.join(map(str, pose[:3, 3]))} 1 {name}.jpg\n")
        if images:
            (tmp_path / "images").mkdir(exist_ok=True)
            Image.new("RGB", (80, 64)).save(tmp_path / "images" / f"{name}.jpg")
    (tmp_path / "sparse/0").mkdir(parents=True)
    (tmp_path / "sparse/0/cameras.txt").write_text("\n".join(rows))
    (tmp_path / "sparse/0/images.txt").write_text("\n".join(posed) + "\n")
    capture = recognise(tmp_path)
    assert (capture.facts["format"], capture.facts["cameras"], capture.facts["times"]) == ("n3v", 4, 6)
    for name, pose in zip(capture.names, capture.cam_from_world, strict=True):
        k = next(k for k, own in names.items() if name.startswith(f"{own}.MP4"))
        np.testing.assert_allclose(pose, views[k].camera.cam_from_world, atol=1e-8)
    (tmp_path / "left.MP4").rename(tmp_path / "right.MP4")  # a name that the model has not: half of the cameras are no longer its own
    (tmp_path / "A.MP4").rename(tmp_path / "B.MP4")
    assert recognise(tmp_path).facts["format"] == ("colmap" if images else "videos")


def test_rows_of_poses_belong_to_cameras_in_plain_order(tmp_path):
    written = write_multiview(make(RIG), tmp_path, False)
    (tmp_path / "poses_bounds_multipleview.npy").unlink()
    files = []
    for file in written.files:
        number = int(file[3:5])
        files.append(f"cam{number}{file[5:]}")
        (tmp_path / files[-1]).parent.mkdir(exist_ok=True)
        (tmp_path / file).rename(tmp_path / files[-1]) if files[-1] != file else None
    for number in range(1, 10):
        (tmp_path / f"cam{number:02d}").rmdir()
    first = {file.split("/")[0]: view for file, view in reversed(list(zip(files, written.views, strict=True)))}
    np.save(tmp_path / "poses_bounds.npy", np.stack([llff_row(first[name]) for name in sorted(first)]))
    capture = recognise(tmp_path)
    views = dict(zip(files, written.views, strict=True))
    for i, name in enumerate(capture.names):
        np.testing.assert_allclose(capture.cam_from_world[i], views[name].camera.cam_from_world, atol=1e-8)
    assert "cam1 is test" in capture.facts["why"] and any("cam1, cam10, cam11, cam2" in note for note in capture.notes)


def test_frames_of_a_rig_that_have_other_names_are_told(tmp_path):
    write_multiview(make(RIG), tmp_path)
    (tmp_path / "cam03/frame_00002.jpg").rename(tmp_path / "cam03/frame_00007.jpg")
    assert any("frame_00002, frame_00007" in note for note in recognise(tmp_path).notes)


def test_rig_without_poses_says_what_is_missing(tmp_path):
    write_multiview(make(RIG), tmp_path)
    shutil.rmtree(tmp_path / "sparse_")
    (tmp_path / "poses_bounds_multipleview.npy").rename(tmp_path / "poses_bounds_mine.npy")
    refused(tmp_path, "cam01, cam02", "cameras of a rig", "poses_bounds.npy", "sparse/0", "seen: poses_bounds_mine.npy", "video")


@pytest.mark.parametrize("folder", ["rgb", "rgbd"])
def test_record3d(path, tmp_path, folder):
    written = write_record3d(path, tmp_path, folder)
    capture = recognise(tmp_path)
    assert (capture.facts["format"], capture.facts["cameras"]) == ("record3d", 1)
    assert_truth(capture, written)
    assert capture.seconds[-1] == pytest.approx(11 / 60)
    if importlib.util.find_spec("lzfse") is None:
        assert any(f"12 depth maps are not read (first {folder}/0.depth)" in note for note in capture.notes)
    data = json.loads((tmp_path / "metadata.json").read_text())
    rows = {**data, "K": np.reshape(data["K"], (3, 3)).T.tolist()}  # some writers list rows
    (tmp_path / "metadata.json").write_text(json.dumps(rows))
    assert_truth(recognise(tmp_path), written)
    stamps = {**data, "frameTimestamps": [5 + 0.5 * i for i in range(12)], "perFrameIntrinsicCoeffs": [[30, 31, 19, 15]] * 12, "K": None}
    (tmp_path / "metadata.json").write_text(json.dumps(stamps))
    timed = recognise(tmp_path)
    assert timed.seconds[-1] == pytest.approx(5.5) and timed.K[3].ravel().tolist() == [30, 0, 19, 0, 31, 15, 0, 0, 1]
    (tmp_path / folder / "3.jpg").unlink()
    left = recognise(tmp_path)
    assert len(left.names) == 11 and any("1 of 12 poses" in note and "3.jpg" in note for note in left.notes)
    (tmp_path / "metadata.json").write_text(json.dumps({k: v for k, v in data.items() if k != "poses"}))
    refused(tmp_path, "metadata.json: no poses")


@pytest.mark.parametrize("corrected", [True, False])
def test_polycam(path, tmp_path, corrected):
    """Time stamps gain a digit within the recording."""
    written = write_polycam(path, tmp_path, corrected)
    capture = recognise(tmp_path)
    assert (capture.facts["format"], capture.facts["cameras"]) == ("polycam", 1)
    assert_truth(capture, written)
    (note,) = [note for note in capture.notes if "depth" in note]
    assert note.startswith("12 depth maps (first keyframes/depth/") and "are not read: depth must have the shape of its picture" in note
    (tmp_path / written.files[2]).unlink()
    assert any("1 of 12 camera files have no picture" in note for note in recognise(tmp_path).notes)
    file = tmp_path / f"keyframes/{'corrected_' if corrected else ''}cameras/100003.json"
    file.write_text(json.dumps({k: v for k, v in json.loads(file.read_text()).items() if k != "t_23"}))
    refused(tmp_path, "100003.json: t_23", "the pose")
    shutil.rmtree(file.parent)
    refused(tmp_path, "keyframes/cameras")


def test_stray_scanner(path, tmp_path):
    written = write_stray(path, tmp_path)
    capture = recognise(tmp_path)
    assert (capture.facts["format"], capture.facts["cameras"], capture.facts["depths"]) == ("stray", 1, 12)
    assert_truth(capture, written)
    assert capture.seconds[-1] == pytest.approx(11 / 60) and capture.depth_confidences[3] == "confidence/000003.png"
    frames = FrameSet(run_frames(tmp_path, tmp_path / "out").artifact, tmp_path)
    depth, sure = frames.depth(4)
    assert np.all(depth == 1504) and np.all(sure == 2), "the maps of the frames that they were taken with"
    thinned = recognise(tmp_path, every=3)
    assert thinned.depths == tuple(f"depth/{i:06d}.png" for i in (0, 3, 6, 9))


def test_older_recordings_of_stray_scanner_number_no_frames(path, tmp_path):
    written = write_stray(path, tmp_path)
    lines = [line.split(",")[2:] for line in (tmp_path / "odometry.csv").read_text().splitlines()]
    (tmp_path / "odometry.csv").write_text("\n".join(map(",".join, lines)))
    for i in range(12):
        (tmp_path / f"depth/{i:06d}.png").unlink()
        np.save(tmp_path / f"depth/{i:06d}.npy", np.full((16, 20), 1500 + i, np.uint16))
    capture = recognise(tmp_path)
    assert_truth(capture, written)
    assert capture.depths[5] == "depth/000005.npy"


def test_stray_scanner_says_what_does_not_belong_together(path, tmp_path):
    write_stray(path, tmp_path)
    file = tmp_path / "odometry.csv"
    head, *rows = file.read_text().splitlines()
    file.write_text("\n".join([head, *rows[:2], *rows[3:], rows[0].replace("000000", "000012", 1).replace(", 000000", ", 000012")]))
    notes = "; ".join(recognise(tmp_path).notes)
    assert "took all 11 video frames" in notes and "1 frame of rgb.mp4" in notes and "1 pose of odometry.csv" in notes
    for lines, words in (
        ([head, rows[0], rows[0]], ("line 3: frame 0 has two poses",)),
        ([head, *rows[:5]], ("poses for 5 of the 12 frames",)),
        ([head, rows[0].replace("000000", "nan", 1)], ("line 2",)),
        (["timestamp, frame, x, y, z", *rows], ("names no column qx, qy, qz, qw",)),
        ([], ("names no column",)),
    ):
        file.write_text("\n".join(lines))
        refused(tmp_path, "odometry.csv", *words)
    file.write_text("\n".join([head, *rows]))
    (tmp_path / "camera_matrix.csv").write_text("1500, 0, 960\n0, 1500, 720\n0, 0, 1\n")
    refused(tmp_path, "camera_matrix.csv", "960, 720", "40x32", "rgb.mp4")


def test_pictures_with_a_pose_file_each(path, tmp_path):
    written = write_rgbd(path, tmp_path)
    capture = recognise(tmp_path)
    assert (capture.facts["format"], capture.facts["frames"]) == ("rgbd", 12)
    assert_truth(capture, written)
    (note,) = [note for note in capture.notes if "depth" in note]
    assert note.startswith("12 depth maps (first frame-000000.depth.png) are not read: depth must have the shape of its picture")
    np.savetxt(tmp_path / "frame-000004.pose.txt", np.full((4, 4), -np.inf))
    (tmp_path / written.files[7]).unlink()
    notes = "; ".join(recognise(tmp_path).notes)
    assert "1 of 12 poses are not finite" in notes and "1 of 12 poses have no picture" in notes
    (tmp_path / "frame-000002.pose.txt").write_text("1 0 0 x")
    refused(tmp_path, "frame-000002.pose.txt", "numbers")
    (tmp_path / "frame-000002.pose.txt").unlink()
    (tmp_path / "K.txt").unlink()
    refused(tmp_path, "no intrinsics", "K.txt")


def test_nsvf_has_its_own_intrinsics_and_splits_in_names(path, tmp_path):
    written = write_rgbd(path, tmp_path / "flat")
    (tmp_path / "rgb").mkdir()
    (tmp_path / "pose").mkdir()
    for i, file in enumerate(written.files):
        name = f"{0 if i < 6 else 1 if i < 9 else 2}_{i:04d}"
        (tmp_path / "flat" / file).rename(tmp_path / f"rgb/{name}.png")
        (tmp_path / "flat" / file.replace("color.png", "pose.txt")).rename(tmp_path / f"pose/{name}.txt")
    shutil.rmtree(tmp_path / "flat")
    for text in (
        "33 20 16 0.\n0. 0. 0.\n0.\n1.\n32 40\n",
        "33 20 16 0.\n0. 0. 0.\n0.\n1.\n",
        "33 20 16 0\n",
        "66 40 32 0\n0 0 0\n0\n1\n64 80\n",
    ):
        (tmp_path / "intrinsics.txt").write_text(text)
        capture = recognise(tmp_path)
        assert capture.facts["splits"] == {"train": 6, "val": 3, "test": 3} and capture.split.tolist() == [0] * 6 + [1] * 3 + [2] * 3
        assert capture.K[0].tolist() == [[33, 0, 20], [0, 33, 16], [0, 0, 1]], text
        assert capture.facts["static"], "numbers begin again in each split, so they are no times"
    (tmp_path / "intrinsics.txt").write_text("33 0 20 0 33 16 0 0 1\n")
    capture = recognise(tmp_path)
    assert capture.K[0].tolist() == [[33, 0, 20], [0, 33, 16], [0, 0, 1]], "a matrix on one line"
    assert capture.facts["splits"]["val"] == 0, "of a rig of depth cameras, names may begin with their numbers"
    (tmp_path / "intrinsics.txt").write_text("33 20 16\n" + "1 " * 8)
    refused(tmp_path, "intrinsics.txt: expected 4 or 9 or 12 or 16 numbers, found 11")
    (tmp_path / "intrinsics.txt").write_text("33 20 16 0\n0 0 0\n0\n1\ninf nan\n")
    assert recognise(tmp_path).K[0][0, 0] == 33
    (tmp_path / "intrinsics.txt").write_text("33 20 16 0\n0 0 0\n0\n1\n40 inf\n")
    assert recognise(tmp_path).K[0][0, 0] == 33
    (tmp_path / "intrinsics.txt").write_text("33 20 16 0")
    for folder, suffix in (("rgb", "png"), ("pose", "txt")):
        (tmp_path / folder / f"0_0000.{suffix}").rename(tmp_path / folder / f"7_0000.{suffix}")
    assert recognise(tmp_path).facts["splits"]["val"] == 0, "a name of another form: no splits"


def test_scannet_has_folders(path, tmp_path):
    written = write_rgbd(path, tmp_path / "flat")
    root = tmp_path / "scan"
    for folder in ("color", "pose", "depth", "intrinsic"):
        (root / folder).mkdir(parents=True)
    for i, file in enumerate(written.files):
        shutil.copy(written.root / file, root / f"color/{i}.png")
        shutil.copy(written.root / file.replace("color.png", "pose.txt"), root / f"pose/{i}.txt")
    K = np.eye(4)
    K[:3, :3] = written.views[0].camera.K
    np.savetxt(root / "intrinsic/intrinsic_color.txt", K)
    capture = recognise(root)
    assert capture.facts["format"] == "rgbd" and capture.names[2] == "color/2.png"
    for i, view in enumerate(written.views):
        np.testing.assert_allclose(capture.cam_from_world[i], view.camera.cam_from_world, atol=1e-8)
        np.testing.assert_allclose(capture.K[i], view.camera.K)


def test_tum(path, tmp_path):
    written = write_tum(path, tmp_path)
    capture = recognise(tmp_path)
    assert (capture.facts["format"], capture.facts["frames"]) == ("tum", 12)
    assert_truth(capture, written, atol=1e-6)
    assert capture.seconds[-1] == pytest.approx(11 / 30, abs=1e-5)
    lines = (tmp_path / "groundtruth.txt").read_text().splitlines()
    (tmp_path / "groundtruth.txt").write_text("\n".join(lines[:-5]) + "\n")
    assert any("2 of 12 pictures have no pose" in note for note in recognise(tmp_path).notes)
    (tmp_path / "K.txt").unlink()
    refused(tmp_path, "no intrinsics", "K.txt")
    (tmp_path / "groundtruth.txt").write_text("1 2 3\n")
    refused(tmp_path, "groundtruth.txt: line 1")


def test_a_camera_that_the_model_lacks_is_left_out(tmp_path):
    written = write_multiview(make(RIG), tmp_path)
    text = (tmp_path / "sparse_/images.txt").read_text().split("\n\n")
    (tmp_path / "sparse_/images.txt").write_text("\n\n".join(line for line in text if " image4.jpg" not in line))
    capture = recognise(tmp_path)
    assert (capture.facts["cameras"], capture.facts["frames"]) == (10, 20)
    assert any("1 of 11 cameras have no pose" in note and "cam04" in note for note in capture.notes)
    views = dict(zip(written.files, written.views, strict=True))
    for i, name in enumerate(capture.names):
        np.testing.assert_allclose(capture.cam_from_world[i], views[name].camera.cam_from_world, atol=1e-8)


def test_every_format_has_one_reader():
    """`Format`, from which the settings and messages follow, and the tables of readers list the same names."""
    readers = importlib.import_module("e4dgs.stages.captures.recognise")  # the package has a function of that name
    assert sorted([*readers._POSED, *readers._BARE]) == sorted(FORMATS)
