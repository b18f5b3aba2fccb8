"""Videos of one folder that are no cameras: passes whose names may be those of cameras, and versions of one clip."""

import numpy as np
import pytest
from e4dgs.stages.captures import recognise
from tiny_videos import encode


def scene(seed, size=(64, 48)):
    """uint8 [H,W,3]: smooth colours."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[0 : size[1], 0 : size[0]] / max(size)
    waves = [np.sin(rng.uniform(3, 12, 3) * rows[..., None] + rng.uniform(3, 12, 3) * columns[..., None]) for _ in range(2)]
    return np.rint(127.5 + 60 * sum(waves)).clip(0, 255).astype(np.uint8)


def normals(size=(64, 48)):
    """uint8 [H,W,3]: of a ball before grey."""
    y, x = (np.mgrid[0 : size[1], 0 : size[0]] + 0.5 - np.array(size[::-1])[:, None, None] / 2) / (0.45 * size[1])
    z = np.sqrt(np.clip(1 - x**2 - y**2, 0, None))
    found = np.rint(127.5 * (1 + np.stack([x, -y, z], -1)))
    return np.where((x**2 + y**2 < 1)[..., None], found, 128).astype(np.uint8)


def grey(seed):
    return np.repeat(scene(seed)[..., :1], 3, axis=2)


def clip(file, picture, frames=10):
    """The picture moves by a pixel a frame."""
    return encode(file, [np.roll(picture, k, axis=1) for k in range(frames)], options={"crf": "12"})


def cameras_of(root):
    return [video.file for video in recognise(root).videos]


@pytest.mark.parametrize("names", ["left.mp4 right.mp4", "a.mp4 b.mp4", "cam_left.mp4 cam_right.mp4"])
@pytest.mark.parametrize(("word", "passed"), [("normal", normals()), ("alpha", grey(3)), ("depth", grey(4)), ("matte", grey(5))])
def test_pictures_tell_a_pass_of_its_own_name(tmp_path, names, word, passed):
    first, second = names.split()
    clip(tmp_path / first, scene(1))
    clip(tmp_path / second, scene(2))
    other = f"cam_{word}.mp4" if "_" in first else f"{word}.mp4"
    clip(tmp_path / other, passed)
    capture = recognise(tmp_path)
    assert [video.file for video in capture.videos] == [first, second]
    (note,) = [note for note in capture.notes if other in note]
    assert note.startswith(f"{other}: left out, since by the name") and note.endswith("rename it if it is a camera of its own")


@pytest.mark.parametrize("names", ["left.mp4 right.mp4", "a.mp4 b.mp4", "cam_left.mp4 cam_right.mp4"])
@pytest.mark.parametrize("word", ["normal", "alpha"])
def test_a_camera_with_the_name_of_a_pass_is_one_by_its_pictures(tmp_path, names, word):
    first, second = names.split()
    other = f"cam_{word}.mp4" if "_" in first else f"{word}.mp4"
    for seed, name in enumerate((first, second, other)):
        clip(tmp_path / name, scene(seed))
    capture = recognise(tmp_path)
    assert {video.file for video in capture.videos} == {first, second, other}
    assert any(note.startswith(f"{other} is read as a camera: by the name it may show the ") for note in capture.notes)


def test_passes_of_one_video_are_told_one_by_one(tmp_path):
    clip(tmp_path / "shot.mp4", scene(1))
    for word, picture in (("normal", scene(2)), ("depth", scene(3)), ("alpha", scene(4))):  # a name that adds a word is enough
        clip(tmp_path / f"shot_{word}.mp4", picture)
    capture = recognise(tmp_path)
    assert cameras_of(tmp_path) == ["shot.mp4"]
    shown = [note.split(" shows the ")[1].split()[0] for note in capture.notes if "left out, since by the name it shows" in note]
    assert sorted(shown) == ["depth", "mask", "normal"]


def test_grey_pictures_of_another_length_or_among_grey_ones_tell_no_pass(tmp_path):
    clip(tmp_path / "a.mp4", scene(1))
    clip(tmp_path / "b.mp4", scene(2))
    clip(tmp_path / "depth.mp4", grey(3), 13)
    assert len(cameras_of(tmp_path)) == 3
    for seed, name in enumerate("ab"):
        clip(tmp_path / f"{name}.mp4", grey(seed), 13)
    assert len(cameras_of(tmp_path)) == 3


def version(root, name, seed, size=(64, 48), look=1.0):
    """The scene of ``seed`` that moves, darker by ``look``, at half its size if ``size`` is not whole."""
    step = 64 // size[0]
    pictures = [look * np.roll(scene(seed), k, axis=1).reshape(48 // step, step, 64 // step, step, 3).mean((1, 3)) for k in range(10)]
    encode(root / name, np.rint(pictures).astype(np.uint8))


@pytest.mark.parametrize(
    ("files", "read"),
    [
        ({"clip_proxy.mp4": (32, 24), "clip_graded.mp4": (64, 48)}, "clip_graded.mp4"),
        ({"clip_proxy.mp4": (32, 24), "clip_graded.mp4": (64, 48), "clip.mp4": (64, 48)}, "clip.mp4"),
        ({"clip_proxy.mp4": (64, 48), "clip_graded.mp4": (64, 48)}, "clip_graded.mp4"),
        ({"clip_proxy.mp4": (32, 24), "clip_graded.mp4": (64, 48), "clip_original.mp4": (64, 48)}, "clip_original.mp4"),
        ({"clip_graded_proxy.mp4": (32, 24), "clip_graded.mp4": (64, 48)}, "clip_graded.mp4"),
        ({"clip_v2_graded_proxy.mp4": (32, 24), "clip_v2.mp4": (64, 48)}, "clip_v2.mp4"),
        ({"clip_v2_proxy.mp4": (32, 24), "clip_v1.mp4": (64, 48), "clip_v2.mp4": (64, 48)}, "clip_v2.mp4"),
        ({"clip_v2_proxy.mp4": (32, 24), "clip_v1.mp4": (64, 48)}, "clip_v1.mp4"),
        ({"clip_v2.mp4": (32, 24), "clip_v1.mp4": (64, 48)}, "clip_v1.mp4"),
        ({"clip_v2.mp4": (64, 48), "clip.mp4": (64, 48)}, "clip.mp4"),
        ({"clip_1080p.mp4": (32, 24), "clip_2160p_graded.mp4": (64, 48)}, "clip_2160p_graded.mp4"),
    ],
)
def test_of_the_versions_of_a_clip_one_is_read_and_no_proxy(tmp_path, files, read):
    for k, (name, size) in enumerate(files.items()):
        version(tmp_path, name, 1, size, 1 - 0.1 * k)
    capture = recognise(tmp_path)
    assert [video.file for video in capture.videos] == [read]
    for name in files.keys() - {read}:
        (note,) = [note for note in capture.notes if note.startswith(f"{name} (")]
        assert f"it is the same clip as {read} (" in note and "which is read; rename it if" in note


def test_the_original_is_read_though_a_version_is_larger_and_it_is_said(tmp_path):
    version(tmp_path, "clip.mp4", 1, (32, 24))
    version(tmp_path, "clip_graded.mp4", 1, (64, 48))
    (video,) = recognise(tmp_path).videos
    assert video.file == "clip.mp4"
    assert any("to read it though, since it is larger, take the other one out" in note for note in recognise(tmp_path).notes)


def test_views_with_the_names_of_versions_are_cameras(tmp_path):
    for k in (1, 2, 3):
        version(tmp_path, f"clip_v{k}.mp4", k)
        version(tmp_path, f"clip_v{k}_proxy.mp4", k, (32, 24))
    assert cameras_of(tmp_path) == ["clip_v1.mp4", "clip_v2.mp4", "clip_v3.mp4"]
