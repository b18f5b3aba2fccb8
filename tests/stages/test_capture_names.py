"""Names of files: their order, their Unicode forms, and paths that lead into the capture or past it."""

import json
import os
import unicodedata

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import checks, recognise
from e4dgs.stages.captures.listing import names as listed
from e4dgs.stages.captures.listing.names import by_value, elsewhere, in_order
from e4dgs.stages.captures.listing.numbers import places
from PIL import Image


def pictures(folder, names, size=(16, 12)):
    for i, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", size, (i, 0, 0)).save(folder / name, format="PNG" if name.endswith("png") else None)
    return folder


def scene(root, paths, **head):
    frames = [{"file_path": path, "transform_matrix": np.eye(4).tolist()} for path in paths]
    (root / "transforms.json").write_text(json.dumps({"fl_x": 20.0, **head, "frames": frames}), encoding="utf-8")
    return root


@pytest.mark.parametrize(
    "ordered",
    [
        ["0.0.png", "0.03.png", "0.07.png", "0.1.png", "0.13.png", "0.25.png", "1.0.png"],
        ["t0.9.png", "t0.95.png", "t1.0.png", "t10.25.png"],
        ["1.25.png", "1.5.png", "10.0.png"],
        ["1.1.png", "1.2.png", "1.9.png", "1.10.png", "1.11.png", "2.1.png"],  # counters: no decimal number ends in 10
        ["1.05.png", "1.10.png", "1.20.png"],
        ["2.png", "9.PNG", "10.png"],
        ["a1.5.png", "a1.25.png", "b1.1.png"],  # two texts: no numbers alone
        ["img01.png", "img1.png", "img1a.png", "img02.png", "img2.png"],
    ],
)
def test_order_of_names(ordered):
    assert in_order(reversed(ordered)) == in_order(ordered) == ordered


def test_decimal_numbers_are_times_and_it_is_said(tmp_path):
    root = pictures(tmp_path / "photos", ["0.1.png", "0.03.png", "0.25.png", "0.0.png"])
    capture = recognise(root)
    assert capture.names == ("0.0.png", "0.03.png", "0.1.png", "0.25.png")
    assert any("sorted by value" in note for note in capture.notes)
    assert not by_value(["0.10.png", "0.25.png"]) and not by_value([])


@pytest.mark.parametrize(("on_disk", "in_file"), [("NFD", "NFC"), ("NFC", "NFD")])
def test_letters_with_accents_are_found_in_either_form(tmp_path, on_disk, in_file):
    names = [f"séance/café_{i}.png" for i in range(4)]
    root = pictures(tmp_path / "s", [unicodedata.normalize(on_disk, name) for name in names])
    scene(root, [unicodedata.normalize(in_file, name) for name in names])
    capture = recognise(root)
    assert capture.images == tuple(unicodedata.normalize(on_disk, name) for name in names)
    (root / "café").mkdir()
    assert listed.on_disk(root, unicodedata.normalize("NFD", "café") + "/x") == "café/x"


def test_absolute_paths_into_the_capture_are_read(tmp_path):
    root = pictures(tmp_path / "real", [f"images/{i}.png" for i in range(4)])
    (tmp_path / "link").symlink_to(root)
    for given in (root, tmp_path / "link"):
        scene(root, [f"{given}/images/{i}.png" for i in range(4)])
        for read in (root, tmp_path / "link"):
            assert recognise(read).images == tuple(f"images/{i}.png" for i in range(4))


@pytest.mark.parametrize(
    "path", ["/etc/hostname", "/", "{root}", "{root}x/0.png", "{root}/../0.png", "~/0.png", "C:/0.png", "../0.png", "a\0b"]
)
def test_paths_out_of_the_capture_are_refused(tmp_path, path):
    root = pictures(tmp_path / "s", ["0.png"])
    pictures(tmp_path, ["0.png"])
    with pytest.raises(CaptureError, match=r"here: the path .* leaves the capture"):
        checks.seek_image(root, path.format(root=root), "here")


def test_a_picture_that_lies_elsewhere_is_named(tmp_path):
    root = pictures(tmp_path / "s", ["a/0.png", "b/1.png", "c/1.png"])
    assert elsewhere(root, "images/0.png") == "a/0.png" == elsewhere(root, "0")
    assert elsewhere(root, "images/1.png") is None and elsewhere(root, "2.png") is None
    with pytest.raises(CaptureError, match=r"no image 'images/0\.png' in .*; a file of that name is a/0\.png: correct the path"):
        checks.find_image(root, "images/0.png", "here")
    with pytest.raises(CaptureError, match="add the file or remove the frame"):
        checks.find_image(root, "images/1.png", "here")


def test_all_suffixes_of_jpeg_are_read(tmp_path):
    for i, suffix in enumerate((".jpg", ".JPG", ".jpeg", ".jfif", ".jpe", ".JFIF")):
        Image.new("RGB", (16, 12)).save(tmp_path / f"{i}{suffix}", format="JPEG")
    assert recognise(tmp_path).facts["frames"] == 6
    scene(tmp_path, [str(i) for i in range(6)])
    assert len(recognise(tmp_path).images) == 6 and os.path.exists(tmp_path / "3.jfif")


@pytest.mark.parametrize(
    ("numbers", "times", "line"),
    [
        ((1, 2, 3, 7, 8), (0, 2 / 7, 1), "the names skip 4 to 6: times follow the numbers, as if these pictures were missing"),
        ((5, 10, 15, 30), (0, 2 / 5, 1), "the names skip 20 to 25: times follow"),
        ((1, 3, 4, 6, 7), (0, 1 / 2, 1), "the names skip 2, 5: times follow"),
        ((3, 8, 13, 18, 23), (0, 1 / 2, 1), None),
        ((1, 2, 3, 800, 801), (0, 1 / 2, 1), "rise unevenly, most from f003.png to f800.png: the pictures are taken as evenly spaced"),
        ((1, 2, 3, 998, 999), (0, 1 / 2, 1), "begun again after f999.png, so f998.png to f999.png are taken as the last though they were"),
        ((101, 134, 168, 201, 300), (0, 1 / 2, 1), "rise unevenly, most from f201.png to f300.png"),
    ],
)
def test_pictures_that_are_missing_have_had_their_time(tmp_path, numbers, times, line):
    for n in numbers:
        Image.new("RGB", (16, 12), (n % 256, 0, 0)).save(tmp_path / f"f{n:03d}.png")
    capture = recognise(tmp_path, holdout=0, fps=10)
    np.testing.assert_allclose(capture.time[[0, 2, -1]], times)
    assert [note for note in capture.notes if any(word in note for word in ("skip", "unevenly", "begun again"))] == [
        note for note in capture.notes if line and line in note
    ]
    assert len(capture.notes) == (line is not None)
    step = (numbers[1] - numbers[0]) if numbers[0] != 1 or numbers[1] != 3 else 1
    span = (numbers[-1] - numbers[0]) // step if line is None or "follow" in line else len(numbers) - 1
    assert capture.seconds[-1] == pytest.approx(span / 10)
    thinned = recognise(tmp_path, holdout=0, fps=10, every=2)
    np.testing.assert_allclose(thinned.seconds, capture.seconds[::2])
    still = recognise(tmp_path, static=True)
    assert not still.time.any() and still.notes == (), "photos of a scene that stands still have no times"


def test_decimal_numbers_with_a_gap_are_times_and_other_names_say_nothing():
    assert places(["0.0.png", "0.25.png", "0.5.png", "1.0.png"])[0] == [0, 1, 2, 4]
    assert places(["0.00.png", "0.25.png", "0.50.png", "1.00.png"])[0] == [0, 1, 2, 4]
    assert places(["0.25.png", "0.5.png", "1.25.png"])[0] == [0, 1, 2] and "unevenly" in places(["0.25.png", "0.5.png", "1.25.png"])[1]
    assert places(["2024_1.png", "2024_2.png", "2024_3.png", "2024_5.png"])[0] == [0, 1, 2, 4], "one number is that of all"
    assert places(["a1_1.png", "a1_2.png", "a2_9.png"]) == ([0, 1, 2], None)
    assert places(["a.png", "b1.png", "c9.png"]) == ([0, 1, 2], None)
    assert places(["f1.jpg", "f1.png", "f2.png", "f4.png"])[0] == [0, 1, 2, 3], "two pictures have one number"


FLAT_RIGS = {
    "cameras first": (("cam{c:02d}_{t:04d}.png", 3, 6), "3 by 6, cam00_0000.png to cam02_0005.png"),
    "times first": (("Birthday_undist_{t:05d}_{c:02d}.png", 4, 5), "5 by 4, Birthday_undist_00000_00.png to Birthday_undist_00004_03.png"),
    "crops of a panorama": (("frame_{t:05d}_{c}.png", 8, 3), "3 by 8, frame_00000_0.png to frame_00002_7.png"),
}


@pytest.mark.parametrize("case", FLAT_RIGS)
@pytest.mark.parametrize("folder", ["", "images/"])
def test_a_rig_in_one_folder_is_told(tmp_path, case, folder):
    """Only its names speak of several cameras, so it is read as before."""
    (pattern, cameras, times), counts = FLAT_RIGS[case]
    pictures(tmp_path, [folder + pattern.format(c=c, t=t) for c in range(cameras) for t in range(times)])
    capture = recognise(tmp_path, fps=30)
    assert capture.facts["cameras"] == 1 and capture.facts["times"] == cameras * times
    (note,) = capture.notes
    assert counts.replace(", ", f", {folder}").replace("to ", f"to {folder}") in note and "ONE camera over time" in note
    assert recognise(tmp_path, static=True).notes == ()


WORDS = {
    "a pair of cameras": ([f"{side}_{t:04d}.png" for side in ("left", "right") for t in range(6)], "left_0000.png and right_0000.png"),
    "one is missing": ([f"{t}_{side}.png" for t in range(6) for side in "LR"][:-1], "0_L.png and 0_R.png"),
    "a drone's colours and heat": (
        [f"DJI_2024010112{t:04d}_{t:04d}_{kind}.png" for t in range(1, 7) for kind in "TV"],
        "DJI_20240101120001_0001_T.png and DJI_20240101120001_0001_V.png",
    ),
}


@pytest.mark.parametrize("case", WORDS)
def test_other_words_for_the_same_numbers_are_told(tmp_path, case):
    names, first = WORDS[case]
    pictures(tmp_path, names)
    capture = recognise(tmp_path, fps=30)
    assert capture.facts["cameras"] == 1 and capture.facts["times"] == len(names)
    (note,) = capture.notes
    assert f"(first {first})" in note and "ONE camera over time" in note
    (note,) = recognise(tmp_path, static=True).notes
    assert f"(first {first})" in note and note.endswith("; if they are versions of one picture, keep one of each")


@pytest.mark.parametrize(
    "names",
    [
        [f"frame_{split}_{t:05d}.png" for split in ("train", "eval") for t in range(4)],  # of nerfstudio
        [f"IMG_{t:04d}.png" for t in range(4)] + [f"DSC_{t:04d}.png" for t in range(40, 44)],
        [f"IMG_{t:04d}.png" for t in range(6)] + ["IMG_E0003.png", "cover.png"],
        ["left.png", "right.png", "top.png"],
    ],
)
def test_words_alone_are_no_cameras(tmp_path, names):
    pictures(tmp_path, names)
    assert not any("ONE camera" in note for note in recognise(tmp_path).notes)


@pytest.mark.parametrize(
    "names",
    [
        [f"take2_{t:04d}.png" for t in range(6)],  # one number
        [f"cam{c}_{t}.png" for c in range(2) for t in range(3)][:-1],  # one is missing
        [f"{t}_{t}.png" for t in range(4)],
        [f"IMG_{20240101 + t // 2}_{120000 + 17 * t}.png" for t in range(4)],  # dates and times of day
        [f"{t // 4}.{t % 4}.png" for t in range(8)],  # decimal numbers
        [f"{a}_{b}_{c}.png" for a in range(2) for b in range(2) for c in range(2)],
    ],
)
def test_other_names_with_two_numbers_are_no_rig(tmp_path, names):
    pictures(tmp_path, names)
    assert not any("ONE camera" in note for note in recognise(tmp_path).notes)
