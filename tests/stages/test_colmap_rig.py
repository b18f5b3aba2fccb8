"""COLMAP models of several cameras: folders of frames with the same names share their times, others are one camera over time."""

import shutil

import numpy as np
import pytest
from e4dgs.pipeline.keys import capture_files
from e4dgs.stages.captures import recognise
from factory import Options, make, write_colmap

RIG = Options(backdrop="room", rig="arc", cameras=3, times=4, width=40, height=32, samples=1, fov_degrees=60.0)


@pytest.fixture
def rig(tmp_path):
    """Three fixed cameras, `images/cam0/000.png` ...; and the truth of each file."""
    written = write_colmap(make(RIG), tmp_path / "rig")
    listed = (written.root / "sparse/0/images.txt").read_text()
    views = {}
    for file, view in zip(written.files, written.views, strict=True):
        name = f"cam{view.camera_index}/{view.time_index:03d}.png"
        (written.root / "images" / name).parent.mkdir(exist_ok=True)
        (written.root / file).rename(written.root / "images" / name)
        listed = listed.replace(f" {file.removeprefix('images/')}\n", f" {name}\n")
        views[f"images/{name}"] = view
    (written.root / "sparse/0/images.txt").write_text(listed)
    return written.root, views


def lines(root):
    return (root / "sparse/0/images.txt").read_text().splitlines()


def test_folders_with_frames_of_the_same_names_are_cameras(rig):
    root, views = rig
    capture = recognise(root, fps=30)
    facts = capture.facts
    assert (facts["cameras"], facts["times"], facts["frames"], facts["fixed_cameras"], facts["static"]) == (3, 4, 12, True, False)
    assert facts["why"] == "a COLMAP model in sparse/0, 3 cameras" and not capture.notes
    for i, name in enumerate(capture.names):
        view = views[name]
        assert (capture.camera[i], capture.time[i]) == (view.camera_index, pytest.approx(view.time_index / 3))
        np.testing.assert_allclose(capture.cam_from_world[i], view.camera.cam_from_world, atol=1e-9)
    following = recognise(root, holdout=0, fps=30).next
    np.testing.assert_array_equal(following, [1, 2, 3, -1, 5, 6, 7, -1, 9, 10, 11, -1])


def test_a_frame_that_was_not_registered_moves_no_other(rig):
    root, views = rig
    kept = lines(root)
    at = next(i for i, line in enumerate(kept) if line.endswith(" cam1/001.png"))
    (root / "sparse/0/images.txt").write_text("\n".join(kept[:at] + kept[at + 2 :]) + "\n")
    capture = recognise(root)
    assert (capture.facts["cameras"], capture.facts["times"], capture.facts["frames"]) == (3, 4, 11)
    np.testing.assert_allclose(capture.time, [views[name].time_index / 3 for name in capture.names])
    assert any("1 images without a pose" in note for note in capture.notes)


def test_a_picture_without_pose_in_one_folder_moves_nothing(rig):
    """Also where its name lies between those of two times. It is among the files of the capture, so keys change with it."""
    root, _ = rig
    before = recognise(root)
    shutil.copy(root / "images/cam0/000.png", root / "images/cam0/001b.png")
    capture = recognise(root)
    assert (capture.facts, capture.names) == (before.facts, before.names)
    np.testing.assert_array_equal(capture.time, before.time)
    np.testing.assert_array_equal(capture.camera, before.camera)
    assert set(capture.files) - set(before.files) == {"images/cam0/001b.png"}


def test_what_decides_whether_folders_are_a_rig_is_in_the_digest(rig):
    """The folders look alike because of a picture without pose. Without it they are one camera, and no earlier result may be taken."""
    root, _ = rig
    kept = lines(root)
    at = next(i for i, line in enumerate(kept) if line.endswith(" cam1/001.png"))
    (root / "sparse/0/images.txt").write_text("\n".join(kept[:at] + kept[at + 2 :]) + "\n")
    with_picture = recognise(root)
    digests = capture_files(with_picture)
    (root / "images/cam1/001.png").unlink()
    without = recognise(root)
    assert (with_picture.facts["cameras"], without.facts["cameras"], with_picture.names == without.names) == (3, 1, True)
    assert capture_files(without) != digests


def test_a_time_that_no_camera_registered_leaves_a_gap(rig):
    root, views = rig
    kept, skipped = lines(root), [i for i, line in enumerate(lines(root)) if line.endswith("/001.png")]
    (root / "sparse/0/images.txt").write_text("\n".join(line for i, line in enumerate(kept) if {i, i - 1}.isdisjoint(skipped)) + "\n")
    shutil.copy(root / "images/cam0/000.png", root / "images/cam0/009.png")
    capture = recognise(root)
    assert (capture.facts["cameras"], capture.facts["times"]) == (3, 3)
    np.testing.assert_allclose(capture.time, [views[name].time_index / 3 for name in capture.names])


def test_cameras_that_move_are_not_called_fixed(rig):
    root, _ = rig
    kept = lines(root)
    at = next(i for i, line in enumerate(kept) if line.endswith(" cam1/002.png"))
    parts = kept[at].split()
    parts[5] = str(float(parts[5]) + 0.01)
    (root / "sparse/0/images.txt").write_text("\n".join([*kept[:at], " ".join(parts), *kept[at + 1 :]]) + "\n")
    assert recognise(root).facts["fixed_cameras"] is False and recognise(root).facts["cameras"] == 3


@pytest.mark.parametrize("change", ["one fewer", "other names"])
def test_folders_with_other_frames_are_one_camera_over_time_with_a_note(rig, change):
    root, _ = rig
    kept = lines(root)
    if change == "one fewer":
        (root / "images/cam2/003.png").unlink()
        kept = kept[: next(i for i, line in enumerate(kept) if line.endswith(" cam2/003.png"))]
    else:
        for file in (root / "images/cam2").iterdir():
            file.rename(file.with_name(f"late{file.name}"))
        kept = [line.replace("cam2/", "cam2/late") for line in kept]
    (root / "sparse/0/images.txt").write_text("\n".join(kept) + "\n")
    capture = recognise(root, fps=30)
    assert (capture.facts["cameras"], capture.facts["times"]) == (1, len(capture.names))
    (note,) = capture.notes
    assert "3 folders of images do not hold files of the same names (4 in images/cam0" in note and "one camera over time" in note


def test_folders_with_one_frame_each_show_one_time(rig):
    root, _ = rig
    kept = []
    for line in lines(root):
        if line and not line.endswith("/000.png"):
            (root / "images" / line.split()[-1]).unlink()
        elif line:
            kept += [line, ""]
    (root / "sparse/0/images.txt").write_text("\n".join(kept) + "\n")
    facts = recognise(root, holdout=0).facts
    assert (facts["cameras"], facts["times"], facts["static"]) == (3, 1, True)


def test_a_deleted_picture_leaves_the_rig_one(rig):
    root, views = rig
    (root / "images/cam1/001.png").unlink()
    capture = recognise(root, fps=30)
    assert (capture.facts["cameras"], capture.facts["times"], capture.facts["frames"]) == (3, 4, 11)
    np.testing.assert_allclose(capture.time, [views[name].time_index / 3 for name in capture.names])
    (note,) = capture.notes
    assert "1 of 12 images" in note and "cam1/001.png" in note


def test_words_in_the_names_of_one_folder_tell_cameras_apart(rig):
    """Also cameras that move, as a pair in the hand."""
    root, views = rig
    listed, truth = (root / "sparse/0/images.txt").read_text(), {}
    for file, view in views.items():
        inside = file.removeprefix("images/")
        name = f"{('left', 'middle', 'right')[view.camera_index]}_{view.time_index:03d}.png"
        (root / file).rename(root / "images" / name)
        listed, truth[f"images/{name}"] = listed.replace(f" {inside}\n", f" {name}\n"), view
    rows = listed.splitlines()
    for i in (i for i, row in enumerate(rows) if row.endswith(".png")):
        parts = rows[i].split()
        parts[5] = str(float(parts[5]) + 0.01 * i)
        rows[i] = " ".join(parts)
    (root / "sparse/0/images.txt").write_text("\n".join(rows) + "\n")
    capture = recognise(root)
    assert (capture.facts["cameras"], capture.facts["times"], capture.facts["fixed_cameras"]) == (3, 4, False)
    for i, name in enumerate(capture.names):
        assert (capture.camera[i], capture.time[i]) == (truth[name].camera_index, pytest.approx(truth[name].time_index / 3))
    assert any("left_000.png and images/middle_000.png, are read as 3 cameras" in note for note in capture.notes)


def only_posed(root, keep):
    """Leaves the poses of those pictures whose name `keep` takes, and all pictures on disk."""
    kept = [line for line in lines(root) if line.startswith("#") or (line.endswith(".png") and keep(line.split()[-1]))]
    (root / "sparse/0/images.txt").write_text("".join(line + ("\n" if line.startswith("#") else "\n\n") for line in kept))


@pytest.mark.parametrize("posed", [{0: "000", 1: "000", 2: "000"}, {0: "002", 1: "000", 2: "003"}])
def test_one_pose_for_each_folder_holds_for_all_of_its_pictures(rig, posed):
    """As where a rig was calibrated on its first frames alone: the cameras stand still."""
    root, views = rig
    only_posed(root, lambda name: any(name == f"cam{camera}/{frame}.png" for camera, frame in posed.items()))
    capture = recognise(root, fps=30)
    facts = capture.facts
    assert (facts["cameras"], facts["times"], facts["frames"], facts["fixed_cameras"], facts["static"]) == (3, 4, 12, True, False)
    for i, name in enumerate(capture.names):
        view = views[name]
        assert (capture.camera[i], capture.time[i]) == (view.camera_index, pytest.approx(view.time_index / 3))
        np.testing.assert_allclose(capture.cam_from_world[i], view.camera.cam_from_world, atol=1e-9)
    (note,) = capture.notes
    assert "each of 3 folders has one picture with a pose" in note and "all 4 pictures" in note
    assert recognise(root, static=True).facts["frames"] == 3


def test_a_pose_is_extended_to_the_names_that_all_folders_share(rig):
    root, _ = rig
    only_posed(root, lambda name: name.endswith("/000.png"))
    (root / "images/cam1/003.png").unlink()
    capture = recognise(root)
    assert (capture.facts["cameras"], capture.facts["times"], capture.facts["frames"]) == (3, 3, 9)
    assert any("2 images without a pose" in note for note in capture.notes)
    for file in (root / "images/cam1").iterdir():
        file.rename(file.with_name(f"late{file.name}"))
    (root / "sparse/0/images.txt").write_text((root / "sparse/0/images.txt").read_text().replace("cam1/", "cam1/late"))
    assert recognise(root).facts["frames"] == 3


def test_a_camera_with_two_poses_does_not_stand_still(rig):
    root, _ = rig
    only_posed(root, lambda name: name.endswith("/000.png") or name == "cam1/001.png")
    assert recognise(root).facts["frames"] == 4
