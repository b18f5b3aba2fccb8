"""Pictures that a capture's files name in other words than the disk, pictures that moved or were deleted, and lists of frames."""

import json
import shutil
import unicodedata

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from factory import Options, make, write_nerfies, write_nerfstudio, write_panoptic
from PIL import Image

PATH = Options(backdrop="room", rig="path", times=12, width=40, height=32, samples=1, fov_degrees=60.0)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return write_nerfstudio(make(PATH), tmp_path_factory.mktemp("nerfstudio"))


@pytest.fixture
def root(written, tmp_path):
    return shutil.copytree(written.root, tmp_path / "capture")


def edit(root, change, file="transforms.json"):
    data = json.loads((root / file).read_text())
    change(data)
    (root / file).write_text(json.dumps(data))


def rename(root, change):
    edit(root, lambda data: [f.update(file_path=change(f["file_path"])) for f in data["frames"]])


def assert_truth(capture, written, left=()):
    """All pictures but `left` are there with their own poses, whatever they are called now."""
    views = [view for i, view in enumerate(written.views) if i not in left]
    assert len(capture.names) == len(views)
    for pose, view in zip(capture.cam_from_world, views, strict=True):
        np.testing.assert_allclose(pose, view.camera.cam_from_world, atol=1e-9)


def test_absolute_paths_into_the_capture_are_read(root, written):
    rename(root, lambda path: f"{root}/{path}")
    capture = recognise(root, fps=30)
    assert_truth(capture, written)
    assert capture.images == written.files and not capture.notes


@pytest.mark.parametrize("place", ["/home/me/scene", "C:\\Users\\me\\scene", "/images"])
def test_absolute_paths_of_another_machine_are_read_by_their_ends(root, written, place):
    rename(root, lambda path: f"{place}/{path}" if "\\" not in place else f"{place}\\{path.replace('/', chr(92))}")
    capture = recognise(root, fps=30)
    assert_truth(capture, written)
    (note,) = capture.notes
    assert "12 of 12 frames of transforms.json have absolute paths" in note and "images/000.png" in note
    (root / "images/004.png").unlink()
    left = recognise(root, fps=30)
    assert_truth(left, written, left=(4,))
    assert any("1 of 12 frames" in note and "no image" in note and "004.png" in note for note in left.notes)


def test_paths_that_leave_the_capture_are_refused(root):
    for path in ("/etc/hostname", "../images/003.png", "C:/x.png"):
        edit(root, lambda data, path=path: data["frames"][3].update(file_path=path))
        with pytest.raises(CaptureError, match=r"frame 3: file_path: the path .* leaves the capture"):
            recognise(root)


@pytest.mark.parametrize("on_disk", ["NFC", "NFD"])
def test_names_in_another_unicode_form_are_found(root, written, on_disk):
    for i in range(12):
        (root / f"images/{i:03d}.png").rename(root / "images" / unicodedata.normalize(on_disk, f"café {i:03d}.png"))
    other = {"NFC": "NFD", "NFD": "NFC"}[on_disk]
    rename(root, lambda path: unicodedata.normalize(other, path.replace("images/", "images/café ")))
    assert_truth(recognise(root), written)


def test_pictures_that_moved_together_are_found_by_name(root, written):
    for file in (root / "images").iterdir():
        file.rename(root / file.name)
    capture = recognise(root, fps=30)
    assert_truth(capture, written)
    (note,) = capture.notes
    assert "12 of 12 frames" in note and "'images/000.png', read from 000.png" in note


def test_one_picture_that_moved_is_found(root, written):
    (root / "images/005.png").rename(root / "005.png")
    capture = recognise(root)
    assert_truth(capture, written)
    assert any("1 of 12 frames" in note and "read from 005.png" in note for note in capture.notes)


def test_two_places_of_one_name_are_named_and_not_chosen(root):
    for folder in ("a", "b"):
        shutil.copytree(root / "images", root / folder)
    shutil.rmtree(root / "images")
    with pytest.raises(CaptureError, match=r"no image 'images/000\.png', but a/000\.png and b/000\.png have its name.*12 of 12"):
        recognise(root)


def test_a_depth_map_does_not_take_the_place_of_a_deleted_picture(root, written):
    shutil.copytree(root / "images", root / "depth")
    (root / "images/005.png").unlink()
    capture = recognise(root)
    assert_truth(capture, written, left=(5,))
    assert any("depth/005.png has its name" in note for note in capture.notes)


LISTS = {
    "test alone": ({"test": (1, 5, 11)}, {1: 2, 5: 2, 11: 2}, "the 9 frames that are in no list train"),
    "val alone": ({"val": (0, 1)}, {0: 1, 1: 1}, "the 10 frames that are in no list train"),
    "empty train": ({"train": (), "test": (1,)}, {1: 2}, "the 11 frames that are in no list train"),
    "two left out": ({"train": range(8), "val": (8, 9), "test": (8, 9)}, {8: 2, 9: 2, 10: None, 11: None}, "2 of 12 frames"),
    "train alone": ({"train": range(11)}, {11: None}, "1 of 12 frames"),
    "all": ({"train": range(6), "test": range(6, 12)}, dict.fromkeys(range(6, 12), 2), None),
}


@pytest.mark.parametrize("case", LISTS)
def test_any_list_of_frames_counts(root, case):
    lists, expected, words = LISTS[case]
    edit(root, lambda data: data.update({f"{k}_filenames": [f"./images/{i:03d}.png" for i in v] for k, v in lists.items()}))
    capture = recognise(root, fps=30)
    split = {int(name[7:10]): int(s) for name, s in zip(capture.names, capture.split, strict=True)}
    assert split == {i: expected.get(i, 0) for i in range(12) if expected.get(i, 0) is not None}
    assert any(words in note for note in capture.notes) if words else not capture.notes


def test_lists_may_name_what_no_frame_has_or_what_was_deleted(root):
    names = [f"images/{i:03d}.png" for i in range(12)]
    edit(root, lambda data: data.update(train_filenames=names[:9], test_filenames=[*names[9:], "images/other.png"]))
    (root / "images/010.png").unlink()
    notes = recognise(root, fps=30).notes
    assert any("1 entry of the lists" in note and "images/other.png" in note for note in notes)
    assert any("1 of 12 frames of transforms.json have no image" in note for note in notes) and len(notes) == 2


def test_deleted_pictures_of_nerfies_and_panoptic(tmp_path):
    nerfies = write_nerfies(make(PATH), tmp_path / "nerfies")
    before = recognise(nerfies.root)
    (nerfies.root / nerfies.files[3]).unlink()
    after = recognise(nerfies.root)
    assert len(after.names) == len(before.names) - 1 and any("1 of 12 ids of dataset.json have no image" in note for note in after.notes)
    kept = [i for i, name in enumerate(before.names) if name != nerfies.files[3]]
    np.testing.assert_allclose(after.cam_from_world, before.cam_from_world[kept])
    for file in nerfies.files[4:11]:
        (nerfies.root / file).unlink()
    with pytest.raises(CaptureError, match=r"dataset\.json.*8 of 12 ids"):
        recognise(nerfies.root)
    rig = Options(backdrop="room", rig="arc", cameras=3, times=4, width=40, height=32, samples=1, fov_degrees=60.0)
    panoptic = write_panoptic(make(rig), tmp_path / "panoptic")
    before = recognise(panoptic.root)
    (panoptic.root / "ims/1/000002.jpg").unlink()
    after = recognise(panoptic.root)
    assert (after.facts["frames"], after.facts["cameras"], after.facts["times"], after.facts["fixed_cameras"]) == (11, 3, 4, True)
    assert any("1 of 8 pictures of train_meta.json have no image" in note for note in after.notes)
    kept = [i for i, name in enumerate(before.names) if name != "ims/1/000002.jpg"]
    np.testing.assert_allclose(after.time, before.time[kept])


def test_dycheck_says_what_it_does_not_read(tmp_path):
    written = write_nerfies(make(PATH), tmp_path)
    for folder in ("depth/1x", "covisible/2x/val", "splits"):
        (tmp_path / folder).mkdir(parents=True)
    Image.new("L", (20, 16)).save(tmp_path / "covisible/2x/val/0_000001.png")
    capture = recognise(written.root)
    assert capture.facts["format"] == "nerfies"
    for folder in ("depth/", "covisible/", "splits/"):
        assert any(note.startswith(f"{folder} is not read") for note in capture.notes)


@pytest.mark.parametrize("head", ["/data/x", "images"])
def test_of_equal_names_the_one_with_the_longest_end_is_meant(root, written, head):
    """Two cameras whose folders moved deeper: 001.png is there twice, cam1/001.png once."""
    for i in range(12):
        (root / f"pictures/cam{i % 2}").mkdir(parents=True, exist_ok=True)
        (root / f"images/{i:03d}.png").rename(root / f"pictures/cam{i % 2}/{i // 2:03d}.png")
    rename(root, lambda path: f"{head}/cam{int(path[7:10]) % 2}/{int(path[7:10]) // 2:03d}.png")
    edit(root, lambda data: data.update(train_filenames=[f["file_path"] for f in data["frames"][:10]]))
    capture = recognise(root)
    assert_truth(capture, written, left=(10, 11))
    assert any("12 of 12 frames" in note and "pictures/cam0/000.png" in note for note in capture.notes)


def test_lists_may_be_absolute_where_frames_are_relative(root):
    edit(root, lambda data: data.update(test_filenames=[f"{root}/{f['file_path']}" for f in data["frames"][:3]]))
    np.testing.assert_array_equal(recognise(root).split, [2] * 3 + [0] * 9)


@pytest.mark.parametrize("change", [str.upper, lambda suffix: ".jpg"])
def test_names_with_another_suffix_than_the_files_are_read(root, written, change):
    rename(root, lambda path: path.replace(".png", change(".png")))
    capture = recognise(root, fps=30)
    assert_truth(capture, written)
    (note,) = capture.notes
    assert "12 of 12 frames of transforms.json have other capital letters or another suffix" in note


def test_a_file_of_another_suffix_does_not_take_the_place_of_a_deleted_picture(root, written):
    (root / "images/004.png").unlink()
    Image.new("L", (40, 32), 255).save(root / "images/004.jpg")
    assert_truth(recognise(root), written, left=(4,))


def test_one_file_is_never_two_pictures_that_differ_in_capital_letters(root, written):
    (root / "images/004.png").rename(root / "images/A.png")
    edit(root, lambda data: [data["frames"][i].update(file_path=f"images/{name}.png") for i, name in ((4, "a"), (5, "A"))])
    assert_truth(recognise(root), written, left=(4,))


def unrendered(dnerf_capture, tmp_path, name, head=""):
    """A copy in which the pictures of transforms_NAME.json, whose last names are those of train/, do not exist."""
    root = shutil.copytree(dnerf_capture.root, tmp_path / "capture")
    shutil.rmtree(root / name)
    edit(
        root, lambda data: [f.update(file_path=f"{head}{name}/r_{i:03d}") for i, f in enumerate(data["frames"])], f"transforms_{name}.json"
    )
    return root


@pytest.mark.parametrize("head", ["./", "/home/me/scene/"])
@pytest.mark.parametrize(("name", "count"), [("val", 2), ("test", 4)])
def test_a_held_out_file_without_pictures_is_left_out(dnerf_capture, tmp_path, name, count, head):
    """BlenderNeRF writes the file and never renders its pictures."""
    root = unrendered(dnerf_capture, tmp_path, name, head)
    capture = recognise(root)
    assert capture.facts["splits"] == {"train": 12, "val": 2, "test": 4} | {name: 0}
    assert [image.split("/")[0] for image in capture.images].count("train") == 12 and f"transforms_{name}.json" in capture.files
    told = f"none of the {count} pictures that transforms_{name}.json names is there (first '{head}{name}/r_000'), so this file is not used"
    assert sum(note.startswith(told) for note in capture.notes) == 1 and not any("not read" in note for note in capture.notes)


def test_without_any_held_out_picture_every_eighth_frame_is_held_out(dnerf_capture, tmp_path):
    root = unrendered(dnerf_capture, tmp_path, "test")
    shutil.rmtree(root / "val")
    assert recognise(root).facts["splits"] == {"train": 10, "val": 0, "test": 2}


def test_so_is_the_held_out_camera_of_panoptic(panoptic_capture, tmp_path):
    """As where only the training cameras were downloaded; a picture of camera 1 does not stand in for that of camera 0."""
    root = shutil.copytree(panoptic_capture.root, tmp_path / "capture")
    whole = recognise(root)
    names = [name for row in json.loads((root / "test_meta.json").read_text())["fn"] for name in row]
    held = np.flatnonzero(whole.split == 2)
    assert len(names) == len(held) == 4
    (root / "ims" / names[0]).unlink()
    assert recognise(root).facts["splits"] == {"train": 12, "val": 0, "test": 3}
    for name in names[1:]:
        (root / "ims" / name).unlink()
    capture = recognise(root)
    assert capture.facts["splits"] == {"train": 10, "val": 0, "test": 2} and capture.facts["cameras"] == whole.facts["cameras"] - 1
    np.testing.assert_array_equal(capture.cam_from_world, np.delete(whole.cam_from_world, held, 0))
    told = "none of the 4 pictures that test_meta.json names is there (first '0/000000.jpg'), so this file is not used"
    assert sum(note.startswith(told) for note in capture.notes) == 1 and "test_meta.json" in capture.files
    shutil.rmtree(root / "ims")
    with pytest.raises(CaptureError, match=r"train_meta\.json: time 0, camera 0: fn: no image 'ims/1/000000\.jpg'.*12 of 12 pictures"):
        recognise(root)


def test_a_split_whose_pictures_train_is_not_left_out(dnerf_capture, tmp_path):
    """Neither takes train/ the pictures of test/, nor goes it without its own; and half of a file is not none of it."""
    root = unrendered(dnerf_capture, tmp_path, "train")
    with pytest.raises(CaptureError, match=r"transforms_train\.json: frame 0: file_path: no image 'train/r_000'.*12 of 12 frames"):
        recognise(root)
    shutil.rmtree(root)
    root = shutil.copytree(dnerf_capture.root, root)
    for i in range(3):
        (root / f"test/r_{i:03d}.png").unlink()
    with pytest.raises(CaptureError, match="3 of 4 frames"):
        recognise(root)


def test_two_held_out_files_may_name_the_same_pictures_by_absolute_paths(dnerf_capture, tmp_path):
    root = shutil.copytree(dnerf_capture.root, tmp_path / "capture")
    edit(root, lambda data: [f.update(file_path=f"/home/me/{f['file_path'][2:]}") for f in data["frames"]], "transforms_test.json")
    (root / "transforms_val.json").write_text((root / "transforms_test.json").read_text())
    assert recognise(root).facts["splits"] == {"train": 12, "val": 4, "test": 4}
