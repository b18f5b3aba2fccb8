"""The `frames` stage: what it writes, and that damaged pictures stop it."""

import shutil
import struct

import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.frames.settings import FramesSettings, recognise_for
from e4dgs.stages.frames.stage import Frames
from factory import render
from factory.writers import flatten
from PIL import Image
from run_stage import run_frames
from tiny_videos import encode


def run(path, folder, **settings):
    """What the stage alone wrote."""
    return run_frames(path, folder, **settings).artifact


def luma_error(picture, truth):
    """Mean difference in grey levels; colour is stored at half resolution. A shift of one pixel gives 13."""
    difference = picture.astype(float) - truth
    assert np.abs(difference.mean((0, 1))).max() < 3, "a colour cast: the wrong matrix or range"
    return np.abs(difference @ [0.299, 0.587, 0.114]).mean()


def test_posed_images_stay_in_their_files(dnerf_capture, tmp_path):
    frames = run(dnerf_capture.root, tmp_path / "a")
    assert set(frames.names()) == {"camera", "time", "seconds", "split", "next", "K", "cam_from_world", "distortion"}
    shapes = {name: (frames.array(name).shape, str(frames.array(name).dtype)) for name in frames.names()}
    assert shapes == {
        "camera": ((18,), "int32"),
        "time": ((18,), "float64"),
        "seconds": ((18,), "float64"),
        "split": ((18,), "uint8"),
        "next": ((18,), "int32"),
        "K": ((18, 3, 3), "float64"),
        "cam_from_world": ((18, 4, 4), "float64"),
        "distortion": ((18, 4), "float64"),
    }
    assert len(frames.attrs["files"]) == 18 and frames.attrs["background"] == "white" and frames.attrs["format"] == "dnerf"


def test_video_is_decoded_one_chunk_a_frame(video_capture, tmp_path):
    frames = run(video_capture.root, tmp_path / "a")
    images = frames.array("images")
    assert images.shape == (12, 80, 96, 3) and images.chunks == (1, 80, 96, 3)
    assert "files" not in frames.attrs and "K" not in frames
    for i, view in enumerate(video_capture.views):
        truth = flatten(render(video_capture.synthetic.scene, view.camera, view.time, video_capture.synthetic.options.samples))
        assert luma_error(images[i], truth) < 4, f"frame {i} is not what was encoded"


def test_thinned_video_holds_the_frames_it_names(video_capture, tmp_path):
    whole = run(video_capture.root, tmp_path / "whole").read("images")
    thinned = run(video_capture.root, tmp_path / "thinned", every=5)
    assert thinned.attrs["names"] == ["clip.mp4#0", "clip.mp4#5", "clip.mp4#10"]
    np.testing.assert_array_equal(thinned.read("images"), whole[[0, 5, 10]])


def test_synchronised_videos_follow_camera_by_camera(n3v_capture, tmp_path):
    frames = run(n3v_capture.root, tmp_path / "a")
    images = frames.read("images")
    np.testing.assert_array_equal(frames.read("camera"), np.repeat(np.arange(4), 6))
    views = {(v.camera_index, v.time_index): v for v in n3v_capture.views}
    for i in (0, 7, 23):
        view = views[divmod(i, 6)]
        truth = flatten(render(n3v_capture.synthetic.scene, view.camera, view.time, n3v_capture.synthetic.options.samples))
        assert luma_error(images[i], truth) < 4


def test_rotation_in_the_container_is_applied(video_capture, tmp_path):
    """Telephones store portrait videos lying down, with a matrix in the track header that turns them clockwise."""
    data = bytearray(video_capture.root.read_bytes())
    at = data.index(b"tkhd") + 4 + 40
    assert struct.unpack_from(">9i", data, at)[0] == 1 << 16, "the identity stands here"
    struct.pack_into(">9i", data, at, 0, 1 << 16, 0, -1 << 16, 0, 0, 80 << 16, 0, 1 << 30)
    (tmp_path / "portrait.mp4").write_bytes(data)
    lying, upright = run(video_capture.root, tmp_path / "a"), run(tmp_path / "portrait.mp4", tmp_path / "b")
    assert (upright.attrs["width"], upright.attrs["height"]) == (80, 96)
    np.testing.assert_array_equal(upright.read("images")[3], np.rot90(lying.read("images")[3], -1))


def test_max_size_applies_to_decoded_video(video_capture, tmp_path):
    assert run(video_capture.root, tmp_path / "a", max_size=48).array("images").shape == (12, 40, 48, 3)


def test_hint_and_masks_travel_in_attrs(images_capture, panoptic_capture, tmp_path):
    root = shutil.copytree(images_capture.root, tmp_path / "hinted")
    (root / "K.txt").write_text("100 0 48 0 100 40 0 0 1")
    assert run(root, tmp_path / "a", max_size=48).attrs["K_hint"] == [50, 0, 24, 0, 50, 20, 0, 0, 1]
    masks = run(panoptic_capture.root, tmp_path / "b").attrs["mask_files"]
    assert len(masks) == 16 and "seg/1/000000.png" in masks


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_image_cut_short_behind_its_header(tmp_path, suffix):
    """The header is whole, so that recognition cannot see it; the stage names the file."""
    root = tmp_path / "cut"
    root.mkdir()
    noise = np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)
    for i in range(4):
        Image.fromarray(noise).save(root / f"{i}.{suffix}")
    broken = root / f"2.{suffix}"
    broken.write_bytes(broken.read_bytes()[: broken.stat().st_size * 2 // 3])
    with pytest.raises(CaptureError, match=rf"2\.{suffix}: cannot be decoded"):
        run(root, tmp_path / "a")


def test_video_damaged_in_the_middle(video_capture, tmp_path):
    """The container is whole, a picture inside is not: never taken for a good frame."""
    data = bytearray(video_capture.root.read_bytes())
    at = data.index(b"mdat") + 4 + 1500  # behind the encoder's note, inside the pictures
    data[at : at + 2500] = bytes(2500)
    (tmp_path / "clip.mp4").write_bytes(bytes(data))
    with pytest.raises(CaptureError, match=r"clip\.mp4"):
        run(tmp_path / "clip.mp4", tmp_path / "a")


def test_plan_says_where_pictures_come_from(dnerf_capture, video_capture):
    settings = FramesSettings()
    stays = Frames().applies(recognise_for(dnerf_capture.root, settings).facts, settings)
    decoded = Frames().applies(recognise_for(video_capture.root, settings).facts, settings)
    assert stays.needed and "stay in their files" in stays.reason
    assert decoded.needed and "decoded from video" in decoded.reason


def test_settings_are_checked():
    for wrong in ({"holdout": -1}, {"background": "green"}, {"max_size": 0}, {"every": 0}, {"unknown": 1}):
        with pytest.raises(ValueError):
            FramesSettings(**wrong)


def test_frames_that_are_no_new_moment_are_named(tmp_path):
    wall = (np.random.default_rng(1).random((64, 160, 3)) * 255).astype(np.uint8).repeat(4, 0).repeat(4, 1)
    seen = [np.ascontiguousarray(wall[:96, 4 * k : 4 * k + 128]) for k in range(24)]
    shown = [np.zeros_like(seen[0])] * 2 + [seen[k * 4 // 5] for k in range(25)]
    file = encode(tmp_path / "film.mp4", shown, options={"crf": "16"})
    lines = run_frames(file, tmp_path).lines
    assert any(line.startswith("5 of 27 frames repeat the one before (first film.mp4#3)") for line in lines), lines
    assert any(line.startswith("2 of 27 frames are of one colour (first film.mp4#0)") for line in lines), lines
    folder = tmp_path / "pictures"
    folder.mkdir()
    for k, picture in enumerate(shown):
        Image.fromarray(picture).save(folder / f"{k:02d}.png")
    assert run_frames(folder, tmp_path / "second").lines[-2:] == [
        line.replace("film.mp4#3", "03.png").replace("film.mp4#0", "00.png") for line in lines[-2:]
    ]
