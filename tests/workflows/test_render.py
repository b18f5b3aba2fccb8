"""`e4dgs render`: a video that plays, pictures that are the model's own renders, depth, and paths from files."""

import base64
import errno
import json
import os
from pathlib import Path

import av
import e4dgs
import numpy as np
import OpenEXR
import pytest
import torch
import typer
from e4dgs.workflows.cli import app, main
from PIL import Image

QUICK = ["--set", "coarse.iterations=20", "--set", "hulls.budget=0", "--set", "fine.iterations=0", "--device", "cpu"]


@pytest.fixture(scope="module")
def finished(dnerf_capture, tmp_path_factory):
    workspace = tmp_path_factory.mktemp("render") / "workspace"
    assert main(["run", "all", str(dnerf_capture.root), "--workspace", str(workspace), *QUICK]) == 0
    return dnerf_capture, workspace


def render(finished, *options: object) -> int:
    capture, workspace = finished
    return main(["render", str(capture.root), "--workspace", str(workspace), *QUICK, *map(str, options)])


@pytest.mark.parametrize("path", ["turntable", "spiral", "capture"])
def test_a_video_has_as_many_pictures_as_asked_for(finished, tmp_path, path):
    out = tmp_path / "new" / "scene.mp4"
    assert render(finished, "--path", path, "--frames", 7, "--fps", 12, "--out", out) == 0
    with av.open(str(out)) as container:
        stream = container.streams.video[0]
        pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt, stream.average_rate) == ("h264", "yuv420p", 12)
    assert len(pictures) == 7 and np.ptp([p.mean() for p in pictures]) > 0
    assert [f.name for f in out.parent.iterdir()] == ["scene.mp4"], "nothing half-written is left"


def test_a_file_says_where_to_look_and_the_pictures_are_the_model_s_own(finished, tmp_path):
    capture, workspace = finished
    truth = capture.views[0].camera
    opengl = np.linalg.inv(truth.cam_from_world) @ np.diag([1.0, -1, -1, 1])
    views = [
        {"cam_from_world": truth.cam_from_world.tolist(), "K": truth.K.tolist(), "time": 0.25},
        {"transform_matrix": opengl.tolist(), "K": truth.K.tolist(), "time": 0.25},
    ]
    file = tmp_path / "path.json"
    file.write_text(json.dumps({"frames": views}))
    out = tmp_path / "pictures"
    assert render(finished, "--path", file, "--depth", "--out", out) == 0
    assert sorted(f.name for f in out.iterdir()) == ["0000.exr", "0000.png", "0001.exr", "0001.png"]
    model = e4dgs.load(capture.root, workspace=workspace)
    camera = e4dgs.Camera(torch.tensor(truth.K).float(), torch.tensor(truth.cam_from_world).float(), truth.width, truth.height, model.near)
    frame = model.render(camera, 0.25)
    for name in ("0000", "0001"):
        shown = np.asarray(Image.open(out / f"{name}.png")).astype(float) / 255
        assert np.abs(shown - frame.color.clamp(0, 1).numpy()).max() <= 0.51 / 255 + 1e-3
        depth = OpenEXR.File(str(out / f"{name}.exr")).channels()["Z"].pixels
        there = frame.alpha.numpy() > 0
        np.testing.assert_allclose(depth[there], frame.depth.numpy()[there], rtol=1e-3, atol=1e-3)
        assert (~there).any() and (depth[~there] == np.float32(1e10)).all(), "nothing is far away"


def test_a_frozen_moment_is_that_moment_in_every_picture(finished, tmp_path):
    file = tmp_path / "path.json"
    pose = finished[0].views[0].camera.cam_from_world.tolist()
    file.write_text(json.dumps({"frames": [{"cam_from_world": pose}] * 2}))
    assert render(finished, "--path", file, "--time", 0.5, "--out", tmp_path / "frozen") == 0
    first, second = ((tmp_path / "frozen" / f"{k:04d}.png").read_bytes() for k in range(2))
    assert first == second


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("[]", ('"frames"',)),
        ('{"frames": []}', ('"frames"',)),
        ("{", ("not a camera path in JSON",)),
        ('{"frames": [3]}', ("frame 0", "object")),
        ('{"frames": [{}]}', ("frame 0", "neither cam_from_world nor transform_matrix")),
        ('{"frames": [{"cam_from_world": [[1]]}]}', ("frame 0: cam_from_world", "4x4")),
        ('{"frames": [{"transform_matrix": [[0,0,0,0],[0,0,0,0],[0,0,0,0],[0,0,0,1]]}]}', ("transform_matrix", "not rigid")),
        ('{"frames": [{"cam_from_world": EYE, "time": 1.5}]}', ("frame 0: time", "1.5")),
        ('{"frames": [{"cam_from_world": EYE, "K": "wide"}]}', ("frame 0: K", "3x3")),
    ],
)
def test_a_bad_path_is_one_message(finished, tmp_path, capsys, content, words):
    file = tmp_path / "path.json"
    file.write_text(content.replace("EYE", json.dumps(np.eye(4).tolist())))
    assert render(finished, "--path", file, "--out", tmp_path / "out") == 2
    message = capsys.readouterr().err
    assert all(word in " ".join(message.split()) for word in words), message
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--path", "helix", "--out", "a.mp4"), "turntable, spiral, capture"),
        (("--out", "a.gif"), "must end in .mp4"),
        (("--depth", "--out", "a.mp4"), "a video holds no depth"),
        (("--alpha", "--out", "a.mp4"), "an mp4 video holds no transparency; give a folder"),
        (("--frames", 10, "--seconds", 2, "--fps", 30, "--out", "a.mp4"), "makes 60 pictures, not 10"),
        (("--time", "nan", "--out", "a.mp4"), "--time"),
        (("--time", "1.5", "--out", "a.mp4"), "--time"),
        (("--seconds", "inf", "--out", "a.mp4"), "--seconds"),
    ],
)
def test_a_bad_option_is_one_message(finished, capsys, monkeypatch, tmp_path, options, words):
    monkeypatch.chdir(tmp_path)
    assert render(finished, *options) == 2
    assert words in " ".join(capsys.readouterr().err.split()) and not list(tmp_path.iterdir())


def test_the_command_under_the_picture_of_the_readme_is_one():
    caption = (Path(__file__).resolve().parents[2] / "README.md").read_text().split("![")[1].split("]")[0]
    words = caption.partition("e4dgs render ")[2].split()
    found = typer.main.get_command(app).commands["render"].make_context("render", words)  # raises an error for a missing option
    assert found.params["out"].suffix == ".mp4"


def test_what_was_not_trained_is_said_with_the_command_that_trains_it(finished, capsys, tmp_path):
    capture, workspace = finished
    words = ["--workspace", str(workspace), "--preset", "default", "--device", "cpu", "--out", str(tmp_path / "a.mp4")]
    code = main(["render", str(capture.root), *words])
    assert code == 2 and "e4dgs run fine" in " ".join(capsys.readouterr().err.split())


def test_a_folder_that_holds_something_is_left_alone(finished, capsys, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    assert render(finished, "--frames", 1, "--out", tmp_path) == 2
    assert "already holds something" in " ".join(capsys.readouterr().err.split())
    assert [f.name for f in tmp_path.iterdir()] == ["notes.txt"]


def test_a_folder_with_the_name_of_a_video_is_refused_before_anything_is_rendered(finished, capsys, tmp_path, monkeypatch):
    (tmp_path / "scene.mp4").mkdir()
    monkeypatch.setattr("e4dgs.scene.model.Model.render", lambda *words: pytest.fail("rendered"))
    assert render(finished, "--frames", 1, "--out", tmp_path / "scene.mp4") == 2
    message = " ".join(capsys.readouterr().err.split())
    assert f"--out {tmp_path / 'scene.mp4'}: this is a folder" in message and "MarkupError" not in message
    assert [f.name for f in tmp_path.iterdir()] == ["scene.mp4"]


def test_a_file_in_place_of_a_folder_is_refused(finished, capsys, tmp_path):
    (tmp_path / "file").write_text("no folder")
    assert render(finished, "--frames", 1, "--out", tmp_path / "file" / "scene.mp4") == 2
    assert f"{tmp_path / 'file'} is a file, not a folder; give another --out" in " ".join(capsys.readouterr().err.split())


def test_a_folder_whose_parent_cannot_be_written_gets_its_pictures(finished, tmp_path, monkeypatch):
    real, out = os.access, tmp_path / "out"
    out.mkdir()
    monkeypatch.setattr("os.access", lambda path, mode: Path(path) != tmp_path and real(path, mode))
    assert render(finished, "--frames", 1, "--size", 16, "--out", out) == 0
    assert [one.name for one in out.iterdir()] == ["0000.png"]
    assert render(finished, "--frames", 1, "--size", 16, "--out", tmp_path / "other") == 1


@pytest.mark.parametrize("name", ["scene.mp4", "pictures"])
def test_a_place_that_cannot_be_written_is_named_with_what_to_do(finished, capsys, tmp_path, monkeypatch, name):
    def refuse(self, *words, **more):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(self))

    monkeypatch.setattr("pathlib.Path.mkdir", refuse)
    monkeypatch.setattr("e4dgs.scene.model.Model.render", lambda *words: pytest.fail("rendered"))
    file = tmp_path / "path.json"
    file.write_text(json.dumps({"frames": [{"cam_from_world": np.eye(4).tolist()}]}))
    assert render(finished, "--path", file, "--out", tmp_path / name) == 1
    message = " ".join(capsys.readouterr().err.split())
    assert message.startswith(f"error: render: {tmp_path} cannot be written (") and message.endswith("give another --out")


def test_a_name_with_brackets_is_printed_as_it_is(finished, capsys, tmp_path):
    out = tmp_path / "d[" / "a].mp4"  # together they look like the end of a tag
    assert render(finished, "--frames", 1, "--size", 16, "--out", out) == 0
    assert out.is_file() and "d[/a].mp4" in "".join(capsys.readouterr().out.split())


def test_a_larger_picture_shows_the_same_view(finished, tmp_path):
    capture, _ = finished
    width, height = capture.views[0].camera.width, capture.views[0].camera.height
    for size in (width, 2 * width):
        assert render(finished, "--path", "capture", "--frames", 1, "--size", size, "--out", tmp_path / str(size)) == 0
    small, large = (np.asarray(Image.open(tmp_path / str(size) / "0000.png")).astype(float) / 255 for size in (width, 2 * width))
    assert large.shape == (2 * height, 2 * width, 3)
    shrunk = large.reshape(height, 2, width, 2, 3).mean((1, 3))
    assert np.abs(shrunk - small).mean() < 0.01 < np.abs(small - small.mean((0, 1))).mean()


def test_a_video_takes_as_long_as_the_capture(finished, tmp_path, capsys):
    """Twelve times at 30 a second."""
    out = tmp_path / "scene.mp4"
    assert render(finished, "--path", "turntable", "--size", 33, "--out", out) == 0
    with av.open(str(out)) as container:
        stream = container.streams.video[0]
        count, size = sum(1 for _ in container.decode(stream)), (stream.width, stream.height)
    capture = finished[0]
    assert count == len({view.time for view in capture.views}) and size == (32, 32)
    said = " ".join(capsys.readouterr().out.split())
    assert f"{count} pictures of 32x32 (not 33x33: the sizes of a video are even), {count / 30:.4g} s at 30 a second (real time)" in said


def test_alpha_is_that_of_the_model_and_its_colours_do_not_depend_on_the_background(finished, tmp_path):
    capture, workspace = finished
    truth, file, out = capture.views[0].camera, tmp_path / "path.json", tmp_path / "out"
    file.write_text(json.dumps({"frames": [{"cam_from_world": truth.cam_from_world.tolist(), "K": truth.K.tolist(), "time": 0.25}]}))
    assert render(finished, "--path", file, "--alpha", "--depth", "--out", out) == 0
    model = e4dgs.load(capture.root, workspace=workspace)
    camera = e4dgs.Camera(torch.tensor(truth.K).float(), torch.tensor(truth.cam_from_world).float(), truth.width, truth.height, model.near)
    shown = np.asarray(Image.open(out / "0000.png")).astype(float) / 255
    for background in (torch.zeros(3), torch.ones(3), torch.tensor([0.0, 1.0, 0.0])):
        frame = model.render(camera, 0.25, background)
        over = shown[..., :3] * shown[..., 3:] + background.numpy() * (1 - shown[..., 3:])
        assert np.abs(over - frame.color.clamp(0, 1).numpy()).max() < 0.012
    assert np.array_equal(np.asarray(Image.open(out / "masks" / "0000.png")), np.rint(255 * shown[..., 3]))
    assert sorted(OpenEXR.File(str(out / "0000.exr")).channels()) == ["RGBA", "Z"]


def test_the_lens_size_and_rate_of_a_file_reach_the_video(finished, tmp_path, capsys):
    capture = finished[0]
    pose = np.linalg.inv(capture.views[0].camera.cam_from_world) @ np.diag([1.0, -1, -1, 1])
    row = {"camera_to_world": pose.ravel().tolist(), "fov": 40.0, "aspect": 2.0}
    path = {"camera_path": [row] * 6, "render_width": 80, "render_height": 40, "fps": 12, "seconds": 0.5, "camera_type": "perspective"}
    file = tmp_path / "camera_path.json"
    pictures = []
    for fov in (40.0, 20.0):
        row["fov"] = fov
        file.write_text(json.dumps(path))
        assert render(finished, "--path", file, "--time", 0.5, "--out", tmp_path / f"{fov}.mp4") == 0
        with av.open(str(tmp_path / f"{fov}.mp4")) as container:
            stream = container.streams.video[0]
            frames = [frame.to_ndarray(format="rgb24").astype(float) for frame in container.decode(stream)]
            assert (len(frames), stream.average_rate, frames[0].shape) == (6, 12, (40, 80, 3))
        pictures.append(frames[0])
    said = " ".join(capsys.readouterr().out.split())
    assert "nerfstudio's viewer writes them in its own" in said and "0.5 s at 12 a second (as its file says)" in said
    subject = [(np.abs(picture - picture[0, 0]).max(-1) > 40).mean() for picture in pictures]
    assert subject[1] > 1.5 * subject[0] > 0, "half the angle, a larger subject"


def test_a_video_in_large_has_the_colours_of_its_pictures_in_a_browser(browser, tmp_path):
    """A player takes 1280 px for BT.709 if nothing is said, and small pictures for BT.601."""
    from e4dgs.vision.images.movie import encode_movie

    colours = [(203, 48, 34), (30, 200, 60), (20, 40, 220), (240, 200, 10), (128, 128, 128)]
    shown = {}
    for width in (160, 1280):
        wide = width // len(colours)
        picture = np.repeat(np.repeat(np.array([colours], np.uint8), 90 * width // 160, 0), wide, 1)
        data = base64.b64encode(encode_movie([picture] * 5, 30.0)).decode()
        page = browser.new_page()
        if not page.evaluate("document.createElement('video').canPlayType('video/mp4; codecs=\"avc1.640028\"')"):
            pytest.skip("this Chromium plays no H.264")
        shown[width] = page.evaluate(DRAWN, [f"data:video/mp4;base64,{data}", wide, len(colours)])
        page.close()
    for width, found in shown.items():
        assert np.abs(np.array(found) - colours).max() <= 3, (width, found)


DRAWN = """async ([source, wide, count]) => {
  const video = document.createElement("video");
  video.muted = true; video.src = source;
  await new Promise((done, failed) => {
    video.requestVideoFrameCallback(done); video.onerror = () => failed(video.error.message); video.play();
  });
  const canvas = document.createElement("canvas");
  canvas.width = video.videoWidth; canvas.height = video.videoHeight;
  const context = canvas.getContext("2d");
  context.drawImage(video, 0, 0);
  return [...Array(count).keys()].map(k => [...context.getImageData((k + 0.5) * wide, canvas.height / 2, 1, 1).data].slice(0, 3));
}"""
