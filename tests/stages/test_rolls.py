"""Photos in several folders: those of one camera are one sequence, and it is said."""

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from PIL import Image


def photos(root, *names, camera=None):
    exif = Image.Exif()
    if camera:
        exif[0x010F], exif[0x0110] = camera.split()
    for k, name in enumerate(names):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.full((12, 16, 3), 10 * k, np.uint8)).save(root / name, exif=exif)
    return root


PHONE = [*(f"100APPLE/IMG_{k:04d}.JPG" for k in (997, 998, 999)), "101APPLE/IMG_1000.JPG", "101APPLE/IMG_1001.JPG"]


@pytest.mark.parametrize(
    ("folder", "names"),
    [
        ("DCIM/", PHONE),
        ("", PHONE),
        ("DCIM/", ["100CANON/IMG_9998.JPG", "100CANON/IMG_9999.JPG", "101CANON/IMG_0001.JPG"]),
        ("DCIM/", ["103_PANA/P1030001.JPG", "103_PANA/P1030002.JPG"]),
        ("images/", ["b/0001.png", "b/0002.png", "a/0003.png", "a/0005.png", "a/0006.png"]),
        ("", ["part2/f_30.png", "part2/f_31.png", "part10/f_32.png"]),
    ],
)
def test_folders_of_one_camera_are_one_sequence(tmp_path, folder, names):
    root = photos(tmp_path / "roll", *(folder + name for name in names))
    (root / "MISC").mkdir()  # on cards of cameras
    capture = recognise(root)
    assert capture.images == tuple(folder + name for name in names)
    assert (capture.facts["format"], capture.facts["cameras"], capture.facts["frames"]) == ("images", 1, len(names))
    (note,) = [note for note in capture.notes if "read as one sequence of one camera" in note]
    assert note.endswith(
        "if they are several cameras or scenes, pass one folder, or encode one video of each camera and give the folder of videos"
    )
    assert not any("not read" in note for note in capture.notes)


@pytest.mark.parametrize(
    "names",
    [
        ["a/0001.png", "a/0002.png", "b/0001.png", "b/0002.png", "b/0003.png"],  # differently many of the same names
        ["cam0/0001.png", "cam0/0002.png", "cam1/0003.png", "cam1/0004.png"],
        ["train/0001.png", "train/0002.png", "test/0003.png"],
        ["a/0001.png", "a/0002.png", "b/0100.png", "b/0101.png"],
        ["a/x_1.png", "a/x_2.png", "b/y_3.png", "b/y_4.png"],
        ["100APPLE/IMG_0001.JPG", "100APPLE/IMG_0002.JPG", "101APPLE/IMG_0002.JPG"],
        ["100APPLE/IMG_0001.JPG", "100CANON/IMG_0002.JPG"],
    ],
)
def test_other_folders_remain_a_question(tmp_path, names):
    with pytest.raises(CaptureError, match="if one camera took all pictures, copy them into one folder"):
        recognise(photos(tmp_path, *names))


def test_exif_of_two_cameras_and_films_make_no_sequence(tmp_path):
    root = photos(photos(tmp_path / "two", *PHONE[:3], camera="Apple iPhone"), *PHONE[3:], camera="Apple iPad")
    with pytest.raises(CaptureError, match="nothing recognised"):
        recognise(root)
    root = photos(tmp_path / "one", *PHONE, camera="Apple iPhone")
    (root / "100APPLE/IMG_0997.MOV").write_bytes(b"a clip beside its photo")
    assert any("EXIF (Apple iPhone)" in note for note in recognise(root).notes)
    (root / "101APPLE/IMG_1002.MOV").write_bytes(b"a film")
    with pytest.raises(CaptureError, match="nothing recognised"):
        recognise(root)


def test_masks_and_missing_photos_of_a_roll(tmp_path):
    root = photos(tmp_path, *(f"DCIM/{name}" for name in PHONE[:2] + PHONE[3:]))
    photos(root, "masks/100APPLE/IMG_0997.JPG.png")
    capture = recognise(root)
    assert capture.keeps[0] == "masks/100APPLE/IMG_0997.JPG.png"
    assert any("the names skip 999: times follow the numbers" in note for note in capture.notes)


def test_what_exif_says_is_printed_without_control_characters(tmp_path):
    root = photos(tmp_path, *PHONE, camera="Ap\x1b[31mple\x07 iPhone" + 1000 * "x")
    (note,) = [note for note in recognise(root).notes if "EXIF" in note]
    assert note.isprintable() and len(note) < 400
