"""Which camera took a frame of `transforms*.json` or of a COLMAP model, and when, where the files do not say it."""

import json
from pathlib import Path

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from PIL import Image

GAP = [*range(1, 11), *range(31, 41)]  # structure from motion found the first and the last ten of forty frames
LENS = {"w": 32, "h": 24, "fl_x": 30.0}


def picture(file: Path, mode: str = "RGB") -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.effect_noise((32, 24), 50).convert(mode).save(file)


def at(x: float) -> list[list[float]]:
    pose = np.eye(4)
    pose[0, 3] = x
    return pose.tolist()


def transforms(root: Path, frames: list[dict], name: str = "transforms.json") -> Path:
    """Writes a file of frames whose pictures, at `file_path`, are made if their paths are relative."""
    for frame in frames:
        if not frame["file_path"].startswith("/"):
            picture(root / frame["file_path"])
    (root / name).write_text(json.dumps({**LENS, "frames": frames}))
    return root


def colmap(root: Path, names: list[str], poses: list[float]) -> Path:
    for name in names:
        picture(root / "images" / name)
    model = root / "sparse/0"
    model.mkdir(parents=True)
    (model / "cameras.txt").write_text("1 PINHOLE 32 24 30 30 16 12\n")
    (model / "images.txt").write_text(
        "".join(f"{i} 1 0 0 0 {x} 0 0 1 {name}\n\n" for i, (name, x) in enumerate(zip(names, poses, strict=True), 1))
    )
    (model / "points3D.txt").write_text("")
    return root


@pytest.mark.parametrize("layout", ["transforms", "colmap"])
def test_frames_that_structure_from_motion_dropped_have_had_their_time(tmp_path, layout):
    names = [f"frame_{i:05d}.png" for i in GAP]
    if layout == "colmap":
        colmap(tmp_path, names, [0.1 * i for i in GAP])
    else:
        transforms(tmp_path, [{"file_path": f"images/{name}", "transform_matrix": at(0.1 * i)} for name, i in zip(names, GAP, strict=True)])
    capture = recognise(tmp_path)
    np.testing.assert_allclose(capture.time, [(i - 1) / 39 for i in GAP])
    np.testing.assert_allclose(capture.seconds, [(i - 1) / 30 for i in GAP])
    assert any("the names skip 11 to 30" in note for note in capture.notes)
    assert recognise(tmp_path, static=True).facts["times"] == 1


def test_a_rig_whose_names_skip_numbers_has_gaps_in_time(tmp_path):
    names = [f"cam{c}/{i}.png" for c in range(2) for i in (1, 2, 3, 7)]
    capture = recognise(colmap(tmp_path, names, [float(name[3]) for name in names]))
    np.testing.assert_allclose(capture.time, [0, 1 / 6, 1 / 3, 1] * 2)
    np.testing.assert_allclose(capture.seconds, [0, 1 / 30, 2 / 30, 0.2] * 2)
    assert capture.facts["fixed_cameras"] and any("the names skip 4 to 6" in note for note in capture.notes)


@pytest.mark.parametrize("layout", ["transforms", "colmap"])
@pytest.mark.parametrize(
    "name",
    [
        *("{t:04d}/cam{c}.png", "{t:04d}/{c:02d}.png", "frame{t:03d}/image_{c}.png", "{c:02d}/{t:04d}.png", "cam{c}/{t}.png"),
        *("cam{c}/cam{c}_{t:04d}.png", "{t:04d}/{t:04d}_{c}.png"),  # names that begin with that of their folder
    ],
)
def test_poses_say_whether_folders_are_cameras_or_times(tmp_path, layout, name):
    """NVIDIA's mv_images/00000/cam01.jpg, and the usual cam01/00000.jpg."""
    pictures = [(name.format(t=t, c=c), t, c) for t in range(8) for c in range(4) if (t, c) != (5, 3)]
    if layout == "colmap":
        colmap(tmp_path, [file for file, _, _ in pictures], [float(c) for _, _, c in pictures])
    else:
        transforms(tmp_path, [{"file_path": f"images/{file}", "transform_matrix": at(c)} for file, _, c in pictures])
    if name.index("{c") < name.index("{t"):  # a rig by its folders must be whole
        picture(tmp_path / "images" / name.format(t=5, c=3))
    capture = recognise(tmp_path)
    assert (capture.facts["cameras"], capture.facts["times"], capture.facts["fixed_cameras"]) == (4, 8, True)
    told = {f"images/{file}": (t, c) for file, t, c in pictures}
    for file, time, camera in zip(capture.images or (), capture.time, capture.camera, strict=True):
        assert (round(7 * float(time)), int(camera)) == told[file]
    assert not any("read as" in note for note in capture.notes)


def test_moving_cameras_are_told_from_times_by_names_alone_and_it_is_said(tmp_path):
    for number, (name, cameras, words) in enumerate(
        (
            ("{t:05d}/cam{c}.png", 3, "are read as times, and the names as cameras"),
            ("{c:05d}/{t:02d}.png", 3, "are read as cameras, and the names as times"),
            ("cam{c}/{t:02d}.png", 3, None),
            ("{c:02d}/frame{t:02d}.png", 3, None),
        )
    ):
        frames = [
            {"file_path": f"images/{name.format(t=t, c=c)}", "transform_matrix": at(c + 0.1 * t)} for t in range(6) for c in range(cameras)
        ]
        capture = recognise(transforms(tmp_path / str(number), frames))
        assert (capture.facts["cameras"], capture.facts["times"]) == (cameras, 6), name
        said = [note for note in capture.notes if "read as" in note]
        assert (words is None and not said) or (words is not None and words in said[0])


def test_cameras_in_one_folder_whose_names_skip_numbers_have_gaps_in_time(tmp_path):
    names = [f"cam{c}_{i}.png" for c in range(2) for i in (1, 2, 3, 7)]
    capture = recognise(colmap(tmp_path, names, [float(name[3]) for name in names]))
    np.testing.assert_allclose(capture.seconds, [0, 1 / 30, 2 / 30, 0.2] * 2)
    assert any("the names skip 4 to 6" in note for note in capture.notes)


def test_a_picture_that_decides_about_a_rig_is_in_the_digest(tmp_path):
    """As for COLMAP: cached results must not outlive it."""
    frames = [{"file_path": f"images/cam{c}/{i}.png", "transform_matrix": at(c)} for c in range(2) for i in range(3)]
    root = transforms(tmp_path, frames)
    picture(root / "images/cam1/9.png")
    assert "images/cam1/9.png" in recognise(root).files and recognise(root).facts["cameras"] == 2


def test_folders_of_frames_without_times_are_the_cameras_of_a_rig(tmp_path):
    frames = [{"file_path": f"images/cam{c}/{i:04d}.png", "transform_matrix": at(c)} for c in range(3) for i in range(4)]
    capture = recognise(transforms(tmp_path, frames))
    assert (capture.facts["cameras"], capture.facts["times"], capture.facts["fixed_cameras"]) == (3, 4, True)
    np.testing.assert_allclose(capture.time, [0, 1 / 3, 2 / 3, 1] * 3)


@pytest.mark.parametrize("layout", ["transforms", "colmap"])
@pytest.mark.parametrize("name", ["cam{c:02d}/0100.png", "view_{c}/{c}.png", "rig/cam{c}/IMG_{n}.png", "a{c}/a{c}_7.png", "b{c}/{n}.png"])
def test_one_picture_of_each_camera_shows_one_time(tmp_path, layout, name):
    """Whatever the names of the pictures where the folders are named as cameras; elsewhere they have to be alike."""
    names = [name.format(c=c, n=137 * c + 5) for c in range(5)]
    if layout == "colmap":
        colmap(tmp_path, names, [float(c) for c in range(5)])
    else:
        transforms(tmp_path, [{"file_path": f"images/{file}", "transform_matrix": at(c)} for c, file in enumerate(names)])
    capture = recognise(tmp_path)
    rig = not name.startswith("b")
    assert (capture.facts["cameras"], capture.facts["times"], capture.facts["static"]) == ((5, 1, True) if rig else (1, 5, False))
    assert any("read as one camera over time" in note for note in capture.notes) is not rig
    assert not any("frames share times" in note for note in capture.notes)


@pytest.mark.parametrize("name", ["cam{c}_{i:04d}.png", "frame_{i:05d}_{c}.png"])
@pytest.mark.parametrize("layout", ["transforms", "colmap"])
def test_fixed_cameras_in_one_folder_are_told_by_their_names_and_poses(tmp_path, layout, name):
    there = [(c, i, name.format(c=c, i=i)) for c in range(3) for i in range(5) if (c, i) != (1, 2)]
    if layout == "colmap":
        colmap(tmp_path, [file for *_, file in there], [float(c) for c, *_ in there])
    else:
        transforms(tmp_path, [{"file_path": f"images/{file}", "transform_matrix": at(c)} for c, _, file in there])
    capture = recognise(tmp_path)
    assert (capture.facts["cameras"], capture.facts["times"], capture.facts["fixed_cameras"]) == (3, 5, True)
    where = {file: (c, i) for c, i, file in there}
    for file, camera, time in zip(capture.names, capture.camera, capture.time, strict=True):
        assert (camera, time) == (where[Path(file).name][0], pytest.approx(where[Path(file).name][1] / 4))


def test_two_numbers_of_one_moving_camera_are_no_rig(tmp_path):
    names = [f"take{c}_{i}.png" for c in range(2) for i in range(4)]
    assert recognise(colmap(tmp_path, names, [0.1 * k for k in range(8)])).facts["cameras"] == 1


def test_folders_of_splits_are_no_cameras(tmp_path):
    frames = [
        {"file_path": f"{split}/r_{i}.png", "transform_matrix": at(c + 0.1 * i)}
        for c, split in enumerate(("train", "test"))
        for i in range(4)
    ]
    assert recognise(transforms(tmp_path, frames)).facts["cameras"] == 1


def test_moving_cameras_that_share_times_are_told_apart_by_their_folders(tmp_path):
    frames = [
        {"file_path": f"{side}/{i:04d}.png", "transform_matrix": at(c + 0.1 * i), "time": i / 5}
        for c, side in enumerate(("left", "right"))
        for i in range(6)
    ]
    capture = recognise(transforms(tmp_path, frames), holdout=0)
    assert (capture.facts["cameras"], capture.facts["pairs"], capture.facts["fixed_cameras"]) == (2, 10, False)


def test_fixed_cameras_in_the_layout_of_dnerf_stay_cameras(tmp_path):
    for split, cameras in (("train", range(1, 4)), ("test", range(1))):
        frames = [{"file_path": f"{split}/cam{c}_{i}.png", "transform_matrix": at(c), "time": i / 5} for c in cameras for i in range(6)]
        transforms(tmp_path, frames, f"transforms_{split}.json")
    capture = recognise(tmp_path)
    assert (capture.facts["format"], capture.facts["cameras"], capture.facts["times"]) == ("dnerf", 4, 6)
    assert capture.facts["fixed_cameras"] and capture.facts["pairs"] == 15 and capture.facts["why"].endswith("fixed cameras")


def test_frames_in_the_layout_of_dnerf_without_times_say_so(tmp_path):
    transforms(tmp_path, [{"file_path": f"train/{i}.png", "transform_matrix": at(i)} for i in range(4)], "transforms_train.json")
    notes = recognise(tmp_path).notes
    assert any("no frame of transforms_train.json has a time, so all show one moment" in note for note in notes)
    assert not any("has a time" in note for note in recognise(tmp_path, static=True).notes)


def frames_with(tmp_path: Path, **fields: str) -> list[dict]:
    return [
        {"file_path": f"images/{i}.png", "transform_matrix": at(i), **{key: text.format(i) for key, text in fields.items()}}
        for i in range(4)
    ]


@pytest.mark.parametrize("name", ["transforms.json", "transforms_train.json"])
def test_masks_and_depth_with_paths_of_another_place_are_found_by_their_ends(tmp_path, name):
    for i in range(4):
        picture(tmp_path / f"m/{i}.png", "L")
        picture(tmp_path / f"z/{i}.png", "L")
    frames = frames_with(tmp_path, mask_path="/home/bob/scene/m/{}.png", depth_file_path="C:\\scene\\z\\{}")
    capture = recognise(transforms(tmp_path, frames, name))
    assert list(capture.keeps) == [f"m/{i}.png" for i in range(4)] and list(capture.depths) == [f"z/{i}.png" for i in range(4)]


def test_depth_maps_that_are_not_there_are_counted(tmp_path):
    picture(tmp_path / "z/0.png", "L")
    capture = recognise(transforms(tmp_path, frames_with(tmp_path, depth_path="z/{}.png")))
    assert capture.depths[0] == "z/0.png" and any("3 of 4 depth maps that frames name are not there" in note for note in capture.notes)


def test_a_cloud_of_another_place_is_a_note_and_a_path_that_climbs_is_refused(tmp_path):
    root = transforms(tmp_path / "s", frames_with(tmp_path))
    file = root / "transforms.json"
    data = json.loads(file.read_text())
    file.write_text(json.dumps(data | {"ply_file_path": "/home/bob/points.ply"}))
    assert any("ply_file_path: no file '/home/bob/points.ply'" in note for note in recognise(root).notes)
    for path in ("../points.ply", "/home/../../points.ply"):
        file.write_text(json.dumps(data | {"ply_file_path": path}))
        with pytest.raises(CaptureError, match=r"ply_file_path: the path .* leaves the capture"):
            recognise(root)
