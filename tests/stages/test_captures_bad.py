"""A bad capture is one `CaptureError` that names file, frame and field and says what to do."""

import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import checks, recognise
from e4dgs.stages.facts import STANDS_STILL
from e4dgs.vision.images.pictures import read_picture
from PIL import Image

POSE = np.eye(4).tolist()


def scene(root, frames=None, **head):
    """A transforms.json capture of three 16x12 images; `frames` and `head` replace what is written."""
    root.mkdir(exist_ok=True)
    for i in range(3):
        Image.new("RGB", (16, 12)).save(root / f"{i}.png")
    default = [{"file_path": f"{i}.png", "transform_matrix": POSE} for i in range(3)]
    data = {"fl_x": 20.0, **head, "frames": default if frames is None else frames}
    (root / "transforms.json").write_text(json.dumps(data))
    return root


def frames(**changes):
    """Three frames, the middle one changed."""
    result = [{"file_path": f"{i}.png", "transform_matrix": POSE, "time": i / 2} for i in range(3)]
    result[1].update(changes)
    return result


def entry(row, column, value):
    pose = np.eye(4).tolist()
    pose[row][column] = value
    return pose


def refused(root, *words, **options):
    with pytest.raises(CaptureError) as caught:
        recognise(root, **options)
    message = str(caught.value)
    assert all(word in message for word in words), message
    assert "\n" not in message


def test_the_sound_scene_passes(tmp_path):
    assert recognise(scene(tmp_path / "s", frames())).facts["frames"] == 3


def test_paths_that_hold_nothing(tmp_path):
    refused(tmp_path / "absent", "absent", "check the path")
    refused("bad\0name", "check the path")
    (tmp_path / "empty").mkdir()
    refused(tmp_path / "empty", "empty", "pass a video")
    (tmp_path / "text").mkdir()
    (tmp_path / "text/readme.md").write_text("nothing here")
    refused(tmp_path / "text", "nothing recognised", "transforms.json")
    (tmp_path / "word.txt").write_text("not a video")
    refused(tmp_path / "word.txt", "word.txt", "not a video: it looks like a text file")
    refused(scene(tmp_path / "s") / "transforms.json", "pass its folder")
    refused(scene(tmp_path / "s"), "unknown", "nerfstudio", format="blender")
    refused(scene(tmp_path / "s"), "transforms_train.json", format="dnerf")


POSES = {
    "NaN": (entry(0, 3, float("nan")), "finite"),
    "Inf": (entry(1, 1, float("inf")), "finite"),
    "huge integer": (entry(0, 3, 10**400), "finite"),
    "far away": (entry(0, 3, 1e300), "outside"),
    "scaled": ((np.diag([2, 2, 2, 1.0])).tolist(), "not rigid"),
    "mirrored": ((np.diag([-1, 1, 1, 1.0])).tolist(), "mirrors"),
    "singular": ((np.diag([0, 1, 1, 1.0])).tolist(), "not rigid"),
    "last row": (entry(3, 0, 1.0), "last row"),
    "string": (entry(0, 0, "1"), "expected a number"),
    "boolean": (entry(0, 0, True), "expected a number"),
    "short": (POSE[:2], "4x4"),
    "ragged": ([*POSE[:3], [0, 0]], "4x4"),
    "object": ({"a": 1}, "4x4"),
    "absent": (None, "4x4"),
}


@pytest.mark.parametrize("case", POSES)
def test_bad_pose(tmp_path, case):
    pose, word = POSES[case]
    refused(scene(tmp_path / "s", frames(transform_matrix=pose)), "transforms.json: frame 1: transform_matrix", word)


FIELDS = {
    "parent": ({"file_path": "../secret.png"}, ("file_path", "leaves the capture")),
    "hidden parent": ({"file_path": "a/../../secret.png"}, ("file_path", "leaves the capture")),
    "backslash parent": ({"file_path": "..\\secret.png"}, ("file_path", "leaves the capture")),
    "absolute": ({"file_path": "/etc/hostname"}, ("file_path", "leaves the capture")),
    "drive": ({"file_path": "C:/x.png"}, ("file_path", "leaves the capture")),
    "zero byte": ({"file_path": "1\0.png"}, ("file_path", "leaves the capture")),
    "no string": ({"file_path": 7}, ("file_path", "expected a non-empty string")),
    "blank": ({"file_path": " "}, ("file_path", "expected a non-empty string")),
    "time NaN": ({"time": float("nan")}, ("time", "finite")),
    "time text": ({"time": "noon"}, ("time", "expected a number")),
    "time missing": ({"time": None}, ("time", "missing")),
    "zero focal": ({"fl_x": 0.0}, ("focal", "positive")),
    "negative focal": ({"fl_x": -3.0}, ("focal", "positive")),
    "focal text": ({"fl_x": "wide"}, ("fl_x", "expected a number")),
    "centre outside": ({"cx": 4000.0}, ("cx", "outside")),
    "field of view": ({"fl_x": None, "camera_angle_x": 4.0}, ("camera_angle_x", "outside")),
    "other shape": ({"w": 100, "h": 200}, ("100x200", "16x12")),
    "camera model": ({"camera_model": "FISHEYE624"}, ("camera_model", "undistort")),
    "no camera model": ({"camera_model": 7}, ("camera_model", "undistort")),
    "tangential fisheye": ({"is_fisheye": True, "p1": 0.1}, ("p1", "fisheye", "undistort")),
    "k4": ({"k4": 0.1}, ("k4", "undistort")),
    "k1 too large": ({"k1": 1000.0}, ("k1", "outside")),
}


@pytest.mark.parametrize("case", FIELDS)
def test_bad_field_of_a_frame(tmp_path, case):
    change, words = FIELDS[case]
    refused(scene(tmp_path / "s", frames(**change)), "transforms.json", "frame 1", *words)


FILES = {
    "cut short": (b'{"frames": [', "not valid JSON"),
    "not UTF-8": (b'{"frames": "\xff\xfe"}', "UTF-8"),
    "a list": (b"[1, 2]", "JSON object"),
    "no frames": (b"{}", "frames"),
    "frames null": (b'{"frames": null}', "frames"),
    "frames empty": (b'{"frames": []}', "frames"),
    "frames of numbers": (b'{"frames": [1]}', "frame 0"),
    "nested": (b"[" * 200_000, "not valid JSON"),
    "endless digits": (b'{"frames": ' + b"9" * 10_000 + b"}", "not valid JSON"),
    "empty": (b"", "not valid JSON"),
}


@pytest.mark.parametrize("case", FILES)
def test_bad_json_file(tmp_path, case):
    content, word = FILES[case]
    root = scene(tmp_path / "s")
    (root / "transforms.json").write_bytes(content)
    refused(root, "transforms.json", word)


def test_links_are_followed_wherever_they_lead(tmp_path):
    """A capture is only read, and people link what is too big to copy."""
    Image.new("RGB", (16, 12)).save(tmp_path / "elsewhere.png")
    root = scene(tmp_path / "s", frames())
    for target in (tmp_path / "elsewhere.png", "0.png"):
        (root / "1.png").unlink()
        (root / "1.png").symlink_to(target)
        assert recognise(root, fps=30).facts["frames"] == 3 and recognise(root, fps=30).notes == (STANDS_STILL,)


def test_frames_without_an_image_are_left_out_and_counted(tmp_path):
    root = scene(tmp_path / "s", frames())
    (root / "1.png").unlink()
    capture = recognise(root)
    assert capture.images == ("0.png", "2.png")
    assert any("1 of 3 frames of transforms.json have no image" in note and "frame 1" in note for note in capture.notes)
    (root / "2.png").unlink()
    refused(root, "frame 1", "2 of 3 frames", "add the files")


def test_links_in_a_circle(tmp_path):
    root = scene(tmp_path / "s", frames())
    (root / "1.png").unlink()
    (root / "1.png").symlink_to("1.png")
    refused(root, "frame 1", "file_path")


def test_broken_and_unsupported_images(tmp_path):
    root = scene(tmp_path / "s")
    (root / "1.png").write_bytes((root / "1.png").read_bytes()[:20])
    refused(root, "1.png", "not a readable image")
    Image.fromarray(np.zeros((12, 16), np.float32)).save(root / "1.tif")
    (root / "1.tif").rename(root / "1.png")
    refused(root, "1.png", "8 or 16 bits")


def test_grey_of_sixteen_bits_and_print_colours_are_read(tmp_path):
    deep = np.linspace(0, 65535, 12 * 16).reshape(12, 16).round().astype(np.uint16)
    Image.fromarray(deep).save(tmp_path / "deep.png")
    assert np.abs(read_picture(tmp_path, "deep.png") - deep[..., None] / 257.0).max() <= 0.5
    Image.new("CMYK", (16, 12), (255, 0, 0, 0)).save(tmp_path / "print.jpg")
    assert read_picture(tmp_path, "print.jpg").shape == (12, 16, 3)
    for name in ("deep.png", "print.jpg"):
        assert checks.image_header(tmp_path, name)[:2] == (16, 12)


def test_the_same_image_twice(tmp_path):
    refused(scene(tmp_path / "s", frames(file_path="./0.png")), "0.png", "listed twice")


def test_a_video_is_named_and_not_its_folder(video_capture, videos_capture):
    file = next(video_capture.root.glob("*.mp4")) if video_capture.root.is_dir() else video_capture.root
    for options, words in ({"holdout": 1}, "none of them for training"), ({"every_time": 12}, "frames.every_time=12 would train on one"):
        with pytest.raises(CaptureError) as refusal:
            recognise(file, **options)
        assert str(refusal.value).startswith(f"{file}: ") and words in str(refusal.value)
    with pytest.raises(CaptureError, match=r"none of them for training; use frames\.holdout=0"):
        recognise(videos_capture.root, holdout=1)


def test_nothing_to_train_on(tmp_path):
    root = scene(tmp_path / "s")
    refused(root, "none of them for training", "holdout=0", holdout=1)
    refused(root, "frames.every", every=2)
    single = tmp_path / "single"
    single.mkdir()
    Image.new("RGB", (8, 8)).save(single / "0.png")
    refused(single, "one image alone", holdout=0)


def test_one_frame_is_too_few_and_only_a_setting_that_was_made_is_blamed(images_capture, video_capture, videos_capture, tmp_path):
    refused(images_capture.root, "frames.every=100 leaves 1 of 10 frames", "lower it", every=100)
    refused(video_capture.root, "clip.mp4: frames.every=100 leaves 1 of 12 frames", "lower it", every=100)
    refused(videos_capture.root, "shares 1 time(s)", "lower frames.every", every=100)
    with av.open(str(tmp_path / "one.mp4"), "w") as container:
        stream = container.add_stream("mpeg4", rate=24)
        stream.width, stream.height, stream.pix_fmt = 32, 24, "yuv420p"
        container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((24, 32, 3), np.uint8), format="rgb24")))
        container.mux(stream.encode())
    for options in ({}, {"every": 5}):
        with pytest.raises(CaptureError, match=r"one\.mp4: one frame alone has no pose and no depth; pass a longer video") as refusal:
            recognise(tmp_path / "one.mp4", **options)
        assert "frames." not in str(refusal.value)


def test_lists_that_name_no_frame(tmp_path):
    refused(scene(tmp_path / "s", train_filenames=["5.png"], test_filenames=["6.png"]), "transforms.json", "train_filenames")


def test_bad_hint_of_intrinsics(tmp_path):
    root = scene(tmp_path / "s")
    (root / "transforms.json").unlink()
    for content, word in (
        ("1 2 3", "nine numbers"),
        ("a b", "nine numbers"),
        ("0 0 8 0 20 6 0 0 1", "positive"),
        ("9 0 99 0 9 6 0 0 1", "outside"),
    ):
        (root / "K.txt").write_text(content)
        refused(root, "K.txt", word)


def test_videos_cut_short(video_capture, tmp_path):
    whole = video_capture.root.read_bytes()
    for length in (0, 10, len(whole) // 2, len(whole) * 3 // 4):
        (tmp_path / "clip.mp4").write_bytes(whole[:length])
        refused(tmp_path / "clip.mp4", "clip.mp4", "copy it again")


def test_fast_start_video_cut_short_names_the_frame(video_capture, tmp_path):
    """With the index in front a cut file still opens, and merely ends early."""
    av = pytest.importorskip("av")
    with av.open(str(video_capture.root)) as source, av.open(str(tmp_path / "f.mp4"), "w", options={"movflags": "faststart"}) as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.dts is not None:
                packet.stream = stream
                target.mux(packet)
    whole = (tmp_path / "f.mp4").read_bytes()
    assert recognise(tmp_path / "f.mp4").facts["frames"] == 12
    cut = int(len(whole) * 0.8)
    with av.open(str(tmp_path / "f.mp4")) as source:
        intact = sum(packet.pos + packet.size <= cut for packet in source.demux(video=0) if packet.size)
    assert 0 < intact < 12
    (tmp_path / "f.mp4").write_bytes(whole[:cut])
    refused(tmp_path / "f.mp4", f"f.mp4: frame {intact}:", "cut short")


def test_n3v(n3v_capture, tmp_path):
    def broken(change):
        root = tmp_path / "n3v"
        shutil.rmtree(root, ignore_errors=True)
        shutil.copytree(n3v_capture.root, root)
        table = np.load(root / "poses_bounds.npy")
        result = change(root, table)
        if result is not None:
            np.save(root / "poses_bounds.npy", result)
        return root

    def nan(root, table):
        table[2, 3] = np.nan
        return table

    def scaled(root, table):
        table[1, [0, 5, 10]] *= 2
        return table

    refused(broken(lambda root, table: table[:3]), "poses_bounds.npy", "3 rows for 4 cameras")
    refused(broken(lambda root, table: table[:, :15]), "poses_bounds.npy", "[N,17]")
    refused(broken(nan), "poses_bounds.npy: row 2 (cam02.mp4)", "NaN")
    refused(broken(scaled), "poses_bounds.npy: row 1", "not rigid")
    pickled = broken(lambda root, table: None)
    np.save(pickled / "poses_bounds.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    refused(pickled, "poses_bounds.npy", "not a readable numpy array")
    cut = broken(lambda root, table: None)
    (cut / "cam01.mp4").write_bytes((cut / "cam01.mp4").read_bytes()[:200])
    refused(cut, "cam01.mp4", "copy it again")
    lone = tmp_path / "lone"
    lone.mkdir()
    np.save(lone / "poses_bounds.npy", np.zeros((2, 17)))
    refused(lone, "cam00.mp4")


def test_n3v_cameras_of_unequal_length(n3v_capture, tmp_path):
    np.save(tmp_path / "poses_bounds.npy", np.load(n3v_capture.root / "poses_bounds.npy"))
    for camera in range(4):
        (tmp_path / f"cam{camera:02d}").mkdir()
        for t in range(3 - (camera == 2)):
            Image.new("RGB", (80, 64)).save(tmp_path / f"cam{camera:02d}" / f"{t}.png")
    refused(tmp_path, "cam02: 2 frames", "up to 3")


def test_panoptic(panoptic_capture, tmp_path):
    root = shutil.copytree(panoptic_capture.root, tmp_path / "p")
    original = (root / "train_meta.json").read_text()

    def broken(change):
        data = json.loads(original)
        change(data)
        (root / "train_meta.json").write_text(json.dumps(data))
        return root

    refused(broken(lambda d: d["w2c"][1][2][0].__setitem__(3, float("nan"))), "train_meta.json: time 1, camera 2: w2c", "finite")
    refused(broken(lambda d: d["k"][0][1][0].__setitem__(0, 0)), "train_meta.json: time 0, camera 1: k", "positive")
    refused(broken(lambda d: d["fn"][0].__setitem__(0, "../../x.jpg")), "time 0, camera 0: fn", "leaves the capture")
    refused(broken(lambda d: d["fn"].pop()), "train_meta.json", "number of times")
    refused(broken(lambda d: d["fn"][0].pop()), "train_meta.json: time 0", "number of cameras")
    refused(broken(lambda d: d.pop("w")), "train_meta.json: w", "expected a number")
    broken(lambda d: None)
    Image.new("L", (7, 7)).save(root / "seg/1/000000.png")
    refused(root, "seg/1/000000.png", "7x7")
    (root / "test_meta.json").unlink()
    refused(root, "test_meta.json", "missing")


def test_dnerf_times_in_one_split_only(dnerf_capture, tmp_path):
    root = shutil.copytree(dnerf_capture.root, tmp_path / "d")
    data = json.loads((root / "transforms_test.json").read_text())
    for frame in data["frames"]:
        del frame["time"]
    (root / "transforms_test.json").write_text(json.dumps(data))
    refused(root, "transforms_test.json", "time is missing")


def test_times_of_splits_in_other_units(dnerf_capture, tmp_path):
    """Test views may lie between or beyond training views, up to ten times as far: then the unit is in doubt."""
    trained = np.ptp(recognise(dnerf_capture.root).time[recognise(dnerf_capture.root).split == 0])
    for times, fits in ((9.9, True), (10.1, False)):
        root = shutil.copytree(dnerf_capture.root, tmp_path / str(times))
        data = json.loads((root / "transforms_test.json").read_text())
        for i, frame in enumerate(data["frames"]):
            frame["time"] = times * trained * i / (len(data["frames"]) - 1)
        (root / "transforms_test.json").write_text(json.dumps(data))
        if fits:
            recognise(root)
        else:
            refused(root, "the times of the test views span", "transforms_test.json", "same unit")


def test_colmap(colmap_capture, tmp_path):
    root = shutil.copytree(colmap_capture.root, tmp_path / "c")
    cameras = (root / "sparse/0/cameras.txt").read_text()
    (root / "sparse/0/cameras.txt").write_text(cameras.replace("OPENCV", "THIN_PRISM_FISHEYE"))
    refused(root, "cameras.txt: camera 1", "THIN_PRISM_FISHEYE", "undistort")
    (root / "sparse/0/cameras.txt").write_text(cameras)
    images = (root / "sparse/0/images.txt").read_text()
    (root / "sparse/0/images.txt").write_text(images.replace("000.png", "../../0.png"))
    refused(root, "images.txt", "leaves the capture")
    (root / "sparse/0/images.txt").write_text(images[: len(images) // 3])
    refused(root, "sparse/0", "export it again")
    for part in ("cameras", "images"):
        (root / f"sparse/0/{part}.bin").write_bytes(b"\x05\0\0\0\0\0\0\0\x01")
    refused(root, "sparse/0", "cut short")


def test_photos_of_a_phone_are_turned_upright(tmp_path):
    """Stored lying, as EXIF says; poses that come with the files are those of the pictures as stored."""
    lying = np.zeros((12, 16, 3), np.uint8)
    lying[:, :8, 0] = 255  # red at what is the top once it stands
    exif = Image.Exif()
    exif[0x0112] = 6
    for i in range(2):
        Image.fromarray(lying).save(tmp_path / f"{i}.png", exif=exif)
    capture = recognise(tmp_path)
    assert (capture.facts["width"], capture.facts["height"]) == (12, 16) and capture.facts["upright"]
    picture = read_picture(tmp_path, "0.png", upright=True)
    assert picture.shape == (16, 12, 3) and (picture[:8, :, 0] == 255).all() and not picture[8:].any()
    assert read_picture(tmp_path, "0.png").shape == (12, 16, 3)
    posed = scene(tmp_path / "posed", frames())
    Image.fromarray(lying).save(posed / "1.png", exif=exif)
    assert recognise(posed).facts["width"] == 16 and "upright" not in recognise(posed).facts


LOOKS = {
    "html": (b"<!DOCTYPE html><html><body>sign in</body></html>", "looks like a web page (HTML)"),
    "text": ("so much for the \u00fc video\n".encode() * 400, "looks like a text file"),
    "empty": (b"", "the file is empty; copy it again"),
    "zeros": (bytes(5000), "zeros"),
    "pointer": (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 5\n", "git lfs pull"),
    "PDF": (b"%PDF-1.7\n" + bytes(range(256)) * 8, "looks like a PDF document"),
    "DPX": (b"SDPX" + bytes(range(256)) * 8, "looks like a DPX picture"),
    "DPX of little-endian numbers": (b"XPDS" + bytes(range(256)) * 8, "looks like a DPX picture"),
    "Radiance": (b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 8\n" * 40, "looks like a Radiance HDR picture"),
    "HEIC": (b"\0\0\0\x18ftypheic" + bytes(range(256)) * 8, "looks like a HEIC or AVIF picture"),
}


@pytest.mark.parametrize("kind", LOOKS)
@pytest.mark.parametrize("name", ["1.png", "clip.mp4"])
def test_a_file_of_another_kind_is_named(tmp_path, kind, name):
    content, words = LOOKS[kind]
    root = tmp_path / "c"
    root.mkdir()
    for i in range(3 if name == "1.png" else 0):
        Image.new("RGB", (16, 12)).save(root / f"{i}.png")
    (root / name).write_bytes(content)
    with pytest.raises(CaptureError, match=f"{name}: .*{re.escape(words)}") as caught:
        recognise(root)
    assert not re.search(r"<_io|Errno|perhaps cut short|identify", str(caught.value)), caught.value


def test_bytes_that_look_like_nothing_are_called_damaged(tmp_path):
    noise = np.random.default_rng(0).integers(128, 256, 5000, np.uint8).tobytes()
    (tmp_path / "clip.mp4").write_bytes(noise)
    refused(tmp_path / "clip.mp4", "clip.mp4: not a readable video, perhaps cut short (Invalid data found when processing input); copy it")
    (tmp_path / "clip.mp4").rename(tmp_path / "1.png")
    Image.new("RGB", (16, 12)).save(tmp_path / "0.png")
    refused(tmp_path, "1.png: not a readable image (cannot identify image file); copy it again")


def test_a_tiff_of_floating_point_is_a_kind_that_is_not_read(tmp_path):
    for i in range(3):
        assert cv2.imwrite(str(tmp_path / f"{i}.tif"), np.ones((12, 16, 3), np.float32))
    refused(tmp_path, "0.tif: a TIFF picture of 32-bit floating-point numbers in 3 channels", "not read; convert the images to RGB")


def test_an_address_is_to_be_downloaded_first():
    refused("https://example.com/x.mp4", "https://example.com/x.mp4: an address, not a file; download it first")
    refused(Path("s3://bucket/x"), "s3://bucket/x: an address")


def test_a_colmap_model_without_pictures_asks_for_them(colmap_capture, tmp_path):
    root = shutil.copytree(colmap_capture.root, tmp_path / "c")
    shutil.rmtree(root / "images")
    refused(root, "The COLMAP model in sparse/0 is there, but none of its pictures: copy images/ beside sparse/")
    for model in (root / "sparse", root / "sparse/0"):
        refused(model, "a COLMAP model without its pictures: pass the folder that holds sparse/ with the model, and beside it images/")


def test_only_a_folder_that_holds_images_is_to_be_passed(tmp_path):
    (tmp_path / "notes/old").mkdir(parents=True)
    (tmp_path / "notes/old/a.md").write_text("x")
    with pytest.raises(CaptureError) as caught:
        recognise(tmp_path)
    assert "the one that holds" not in str(caught.value)
    (tmp_path / "deep/er").mkdir(parents=True)
    Image.new("RGB", (16, 12)).save(tmp_path / "deep/er/0.png")
    refused(tmp_path, "It has the folders deep, notes: pass the one that holds images")


ANIMATED = {"webp": "an animated WebP", "png": "an animated PNG (APNG)", "tif": "a TIFF of several pages"}


def animation(file, count=5, sizes=((32, 24), (32, 24))):
    first, *others = [Image.new("RGB", sizes[min(i, 1)], (40 * i, 0, 90)) for i in range(count)]
    more = {} if file.suffix == ".tif" else {"duration": 50, "lossless": True}
    first.save(file, save_all=True, append_images=others, **more)
    return file


@pytest.mark.parametrize("alone", [True, False])
@pytest.mark.parametrize("suffix", ANIMATED)
def test_a_file_of_several_pictures_comes_with_a_command_that_makes_a_folder_of_them(tmp_path, suffix, alone):
    (tmp_path / "my clip").mkdir()
    file = animation(tmp_path / "my clip" / f"a.{suffix}")
    with pytest.raises(CaptureError) as caught:
        recognise(file if alone else file.parent)
    said, _, command = str(caught.value).partition(f": {shlex.quote(sys.executable)} ")
    folder = file.with_name("a-pictures")
    rate = "" if suffix == "tif" else " with --set frames.fps=20"
    assert said == (
        f"a.{suffix}: {ANIMATED[suffix]} with 5 pictures, which is not read; make a folder of pictures of it, and pass {folder}{rate}"
    )
    subprocess.run([sys.executable, *shlex.split(command)], check=True)
    capture = recognise(folder)
    assert capture.facts["frames"] == 5
    colours = [read_picture(capture.root, name)[0, 0].tolist() for name in capture.images]
    assert colours == [[40 * i, 0, 90] for i in range(5)]


def test_files_of_several_pictures_among_others_are_told(tmp_path):
    for i in range(3):
        Image.new("RGB", (32, 24)).save(tmp_path / f"{i}.png")
    assert recognise(tmp_path, fps=30).notes == ()
    animation(tmp_path / "3.tif", sizes=((32, 24), (8, 6)))  # its second page is a preview
    assert recognise(tmp_path, fps=30).notes == ()
    animation(tmp_path / "4.webp")
    (line,) = recognise(tmp_path, fps=30).notes
    assert line.startswith("1 file holds several pictures (first 4.webp), of which only the first is read")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("scene.ply", "(point cloud) is no capture; pass the pictures or videos"),
        ("scene.splat", "(mesh or splat file) is no capture; pass the pictures or videos"),
        ("poses.txt", "(pose file) is no capture"),
        ("model.blend", "no kind of file that is known"),
        ("images.bin", "no kind of file that is known"),
        ("one.svo2", "a video of a kind that cannot be read (SVO2 video)"),
        ("a.arx", "one picture of a capture (ARX picture)"),
        ("clip.mp4", "not a video: it looks like a text file"),
    ],
)
def test_a_file_that_is_no_capture_is_told_by_its_kind(tmp_path, name, words):
    (tmp_path / name).write_bytes(b"ply\nformat ascii 1.0\n" * 50)
    refused(tmp_path / name, words)


def test_the_commonest_unknown_suffix_of_a_folder_is_told(tmp_path):
    for name in ("a.xyzzy", "b.xyzzy", "c.odd"):
        (tmp_path / name).write_bytes(b"1")
    refused(tmp_path, "nothing recognised here", "No kind of file that is known ends in .xyzzy (here 2)")


@pytest.mark.parametrize(
    "names", [("drone/d_{}", "ground/g_{}"), ("100CANON/{}", "101CANON/{}"), ("images/drone/d_{}", "images/ground/g_{}")]
)
def test_photos_in_several_folders_are_told_to_be_put_into_one(tmp_path, names):
    for k, name in enumerate(names * 3):
        file = tmp_path / f"{name.format(k // 2)}.png"
        file.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (16, 12)).save(file)
    refused(tmp_path, "if one camera took all pictures, copy them into one folder, under names that differ")
