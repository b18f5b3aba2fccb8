"""Pictures and videos in one folder: photos with clips of a phone, a video with its poster, or a question."""

import av
import numpy as np
import pytest
from e4dgs.pipeline import CaptureError
from e4dgs.stages.captures import recognise
from PIL import Image


def clip(path, frames=4, container=None):
    path.parent.mkdir(parents=True, exist_ok=True)
    random = np.random.default_rng(list(path.name.encode()))  # copies of one video would be one
    with av.open(str(path), "w", format=container) as box:
        stream = box.add_stream("mpeg4", rate=24)
        stream.width, stream.height, stream.pix_fmt = 32, 24, "yuv420p"
        for _ in range(frames):  # noise, since some containers are not recognised by a few bytes
            box.mux(stream.encode(av.VideoFrame.from_ndarray(random.integers(0, 255, (24, 32, 3), np.uint8), format="rgb24")))
        box.mux(stream.encode())


def folder(root, *names):
    """A capture of one-coloured pictures and short clips; what can be neither read nor written here is a stub."""
    for i, name in enumerate(names):
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        suffix = path.suffix.lower()
        if suffix in (".mov", ".mp4", ".avi"):
            clip(path)
        elif suffix == ".heic":
            path.write_bytes(b"\0\0\0\x18ftypheic")
        else:
            Image.new("RGB", (16, 12), (i, 0, 0)).save(path, format="PNG" if suffix == ".png" else "GIF" if suffix == ".gif" else "JPEG")
    return root


def names(stem, suffix, count=4):
    return [f"{stem}{i}{suffix}" for i in range(count)]


@pytest.mark.parametrize(
    ("files", "expected", "says"),
    [
        (
            [*names("IMG_", ".JPG"), *names("IMG_", ".MOV")],
            ("images", 4),
            "4 videos (first IMG_0.MOV) are not read, because the layout is images",
        ),
        ([*names("IMG_", ".JPG"), *names("IMG_", ".MOV", 2)], ("images", 4), "2 videos (first IMG_0.MOV) are not read"),
        ([*names("IMG_", ".JPG"), "IMG_1.MOV"], ("images", 4), "the video IMG_1.MOV is not read"),
        (
            ["clip.mp4", "poster.png", "thumbnail.png"],
            ("video", 4),
            "2 pictures (first poster.png) are not read, because the layout is video",
        ),
        (["clip.mp4", "clip.jpg"], ("video", 4), "the picture clip.jpg is not read"),
        (["clip.mp4", "clip_cover.jpg", "clip-thumb.png", "preview.jpg"], ("video", 4), "3 pictures (first clip-thumb.png) are not read"),
        (["clip.mp4", "IMG_7.jpg"], ("video", 4), "the picture IMG_7.jpg is not read"),
        (["clip.mp4", "still.heic"], ("video", 4), "the HEIC picture still.heic is not read"),
        (["a.mp4", "b.mp4", "thumb_a.jpg", "thumb_b.jpg"], ("videos", 8), "2 pictures (first thumb_a.jpg) are not read"),
        ([*names("", ".png"), "turntable.gif"], ("images", 4), "the video turntable.gif is not read"),
    ],
)
def test_one_of_them_is_meant(tmp_path, files, expected, says):
    capture = recognise(folder(tmp_path / "s", *files))
    assert (capture.facts["format"], capture.facts["frames"]) == expected
    assert any(note.startswith(says) for note in capture.notes), capture.notes


def test_photos_that_cannot_be_read_with_their_clips(tmp_path):
    root = folder(tmp_path / "s", *names("IMG_", ".HEIC"), *names("IMG_", ".MOV"))
    with pytest.raises(CaptureError) as refused:
        recognise(root)
    for words in ("4 photos (first IMG_0.HEIC)", "clip of the same name for 4 of them", "convert them to JPEG", "--format videos"):
        assert words in str(refused.value)
    assert recognise(root, format="videos").facts["cameras"] == 4


@pytest.mark.parametrize(
    ("files", "words"),
    [
        (
            ["clip.mp4", *names("IMG_", ".jpg", 3)],
            ("the video clip.mp4 and 3 pictures (first IMG_0.jpg)", "--format video,", "--format images"),
        ),
        (["a.mp4", "b.mp4", *names("IMG_", ".jpg", 3)], ("2 videos (first a.mp4) and 3 pictures", "--format videos,", "--format images")),
        (
            [*names("cam", ".mp4"), *names("cam", ".jpg")],
            ("4 videos (first cam0.mp4) and 4 pictures", "--format videos,", "--format images"),
        ),
        (
            ["clip.mp4", *names("IMG_", ".heic")],
            ("4 pictures (first IMG_0.heic)", "--format video,", "once they can be read: convert them"),
        ),
    ],
)
def test_otherwise_it_is_a_question(tmp_path, files, words):
    with pytest.raises(CaptureError) as refused:
        recognise(folder(tmp_path / "s", *files))
    assert all(word in str(refused.value) for word in words), refused.value


def test_either_answer_is_taken(tmp_path):
    root = folder(tmp_path / "s", "clip.mp4", *names("IMG_", ".jpg", 3))
    video, images = recognise(root, format="video"), recognise(root, format="images")
    assert (video.facts["format"], video.facts["frames"], video.root, video.name) == ("video", 4, root, "s")
    assert "3 pictures (first IMG_0.jpg) are not read, because the layout is video" in video.notes
    assert images.facts["frames"] == 3 and "the video clip.mp4 is not read, because the layout is images" in images.notes


@pytest.mark.parametrize(
    ("suffix", "container"),
    [("MTS", "mpegts"), ("m2ts", "mpegts"), ("3gp", "mp4"), ("wmv", "asf"), ("asf", "asf"), ("3g2", "mp4"), ("vob", "vob")],
)
def test_videos_of_cameras_and_phones(tmp_path, suffix, container):
    clip(tmp_path / "s" / f"00000.{suffix}", container=container)
    capture = recognise(tmp_path / "s")
    assert (capture.facts["format"], capture.facts["frames"]) == ("video", 4)


def test_streams_that_were_merely_appended_say_how_to_join_them(tmp_path):
    for name in ("1.ts", "2.ts"):
        clip(tmp_path / name, container="mpegts")
    (tmp_path / "both.ts").write_bytes((tmp_path / "1.ts").read_bytes() + (tmp_path / "2.ts").read_bytes())
    with pytest.raises(CaptureError, match=r"both\.ts: frame \d: .*join its parts with ffmpeg's concat demuxer"):
        recognise(tmp_path / "both.ts")
