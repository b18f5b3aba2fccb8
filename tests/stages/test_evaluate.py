"""The evaluate stage: metrics of a model with a known error, missing views, LPIPS with and without weights, pictures."""

import io
import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import av
import cv2
import numpy as np
import pytest
import torch
from blake3 import blake3
from e4dgs.pipeline import Artifact, ArtifactWriter, StageError
from e4dgs.rasterizer import Camera, Frame
from e4dgs.scene.metrics.lpips import Lpips, expected_shapes
from e4dgs.scene.model import Model
from e4dgs.scene.motion.planes.field import DeformationField
from e4dgs.scene.motion.static import Static
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.stages.evaluate.artifact import StoredPictures, read_movies
from e4dgs.stages.evaluate.flicker import measure_flicker
from e4dgs.stages.evaluate.judge import LEAST_TIMES, Judge
from e4dgs.stages.evaluate.pictures.book import depth_picture, depth_range, error_picture
from e4dgs.stages.evaluate.run import means, measured_rows
from e4dgs.stages.evaluate.settings import EvaluateSettings
from e4dgs.stages.evaluate.spread import most_measured, spread, stretches, worst_and_others
from e4dgs.stages.evaluate.stage import Evaluate
from e4dgs.stages.evaluate.views import choose_views
from run_stage import run_stage
from safetensors.torch import save_file

SIZE = (48, 40)  # width, height


def small_model(moving: bool = False) -> Model:
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.6, 0.6, (40, 3)).astype(np.float32)
    colors = rng.uniform(0.1, 0.8, (40, 3)).astype(np.float32)
    field = (
        DeformationField(torch.tensor([-1.0] * 3), torch.tensor([1.0] * 3), times=4, resolutions=(4,), channels=4, width=8)
        if moving
        else Static()
    )
    hulls = rng.uniform(-0.3, 0.3, (2, 6, 3)).astype(np.float32)
    return Model(
        GaussianSet.from_points(points, colors, 1), ConvexSet.from_points(hulls, rng.random((2, 3)).astype(np.float32), 1), field, 1
    )


def cameras(count: int) -> tuple[np.ndarray, np.ndarray]:
    K = np.tile(np.array([[50.0, 0, 24], [0, 50, 20], [0, 0, 1]]), (count, 1, 1))
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 2, 3] = 4.0
    poses[:, 0, 3] = np.linspace(-0.3, 0.3, count)
    return K, poses


def scene(folder: Path, split: list[int], model: Model, offset: float = 0.0, fixed: bool = False, lost: tuple[int, ...] = ()):
    """A capture whose pictures are the model's own renders plus ``offset``, and the context to evaluate it in."""
    count = len(split)
    K, poses = cameras(count)
    if fixed:
        poses[:] = poses[0]
    time = np.linspace(0, 1, count)
    images = np.empty((count, SIZE[1], SIZE[0], 3), np.uint8)
    for i in range(count):
        camera = Camera(torch.tensor(K[i]).float(), torch.tensor(poses[i]).float(), *SIZE)
        color = model.render(camera, float(time[i])).color.clamp(0, 1).numpy()
        images[i] = np.rint(np.clip(color + offset, 0, 1) * 255)
    for i in lost:
        poses[i] = np.nan
    out = ArtifactWriter(folder / "frames")
    (folder / "frames").mkdir(parents=True)
    values = {
        "camera": np.zeros(count, np.int32),
        "time": time,
        "seconds": time,
        "split": np.array(split, np.uint8),
        "next": np.full(count, -1, np.int32),
        "K": K,
        "cam_from_world": poses,
        "distortion": np.zeros((count, 4)),
        "images": images,
    }
    for name, value in values.items():
        out.write(name, value)
    out.attrs.update(
        width=SIZE[0], height=SIZE[1], background="black", alpha=False, names=[f"frame {i}" for i in range(count)], fixed_cameras=fixed
    )
    out.finish({})
    return Artifact(folder / "frames")


def trained(folder: Path, model: Model) -> Artifact:
    folder.mkdir(parents=True)
    out = ArtifactWriter(folder)
    for name, value in model.to_arrays().items():
        out.write(name, value)
    out.attrs["model"] = model.config
    out.finish({})
    return Artifact(folder)


def evaluate(folder: Path, frames: Artifact, coarse=None, fine=None, flow=None, **settings) -> tuple[Artifact, list[str]]:
    capture = SimpleNamespace(root=folder, facts={})
    inputs = {"frames": frames, "poses": None, "flow": flow, "coarse": coarse, "fine": fine}
    ran = run_stage(Evaluate(), capture, folder, EvaluateSettings(**settings), inputs)
    return ran.artifact, ran.lines


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """Six frames, two of them test and one val, each 0.1 brighter than the model's render."""
    folder = tmp_path_factory.mktemp("evaluate")
    model = small_model()
    frames = scene(folder, [0, 2, 0, 1, 0, 2], model, offset=0.1)
    return evaluate(folder, frames, fine=trained(folder / "fine", model))


def test_metrics_of_a_known_error(result):
    artifact, _ = result
    metrics = artifact.attrs["metrics"]
    assert set(metrics) == {"protocol", "splits", "primitives", "flicker"} and metrics["flicker"] is None
    assert metrics["primitives"] == {"gaussians": 40, "convexes": 2}
    test = metrics["splits"]["test"]
    assert test["psnr"] == pytest.approx(20.0, abs=0.2)  # 8-bit rounding and a few saturated pixels
    assert 0.2 < test["ssim"] < 1
    assert [row["frame"] for row in test["per_view"]] == [1, 5] and len(metrics["splits"]["val"]["per_view"]) == 1
    assert set(test["per_view"][0]) == {
        "name",
        "frame",
        "camera",
        "time",
        "psnr",
        "ssim",
        "edge_psnr",
        "lpips",
        "psnr_affine",
        "ssim_affine",
    }
    assert test["psnr"] == pytest.approx(np.mean([row["psnr"] for row in test["per_view"]]))
    protocol = metrics["protocol"]
    assert (protocol["resolution"], protocol["background"], protocol["lpips_net"]) == ("48x40", "black", None)
    assert "test (2 views)" in protocol["split"]


def test_some_training_views_are_measured_beside_the_held_out_ones_and_not_shown(result):
    artifact, _ = result
    train = artifact.attrs["metrics"]["splits"]["train"]
    assert [row["frame"] for row in train["per_view"]] == [0, 2, 4] and train["psnr"] == pytest.approx(20.0, abs=0.2)
    assert {view["split"] for view in artifact.attrs["views"]} == {"val", "test"}
    assert "train (3 views)" in artifact.attrs["metrics"]["protocol"]["split"]


def test_without_weights_lpips_is_null_with_a_reason(result):
    test = result[0].attrs["metrics"]["splits"]["test"]
    assert test["lpips"] is None and "evaluate.lpips_weights" in test["lpips_reason"]
    assert "pip install 'e4dgs[lpips]'" in test["lpips_reason"] and "e4dgs run evaluate CAPTURE --force" in test["lpips_reason"]


def test_timings_are_not_content(result):
    artifact, _ = result
    assert artifact.info["metrics"]["render_fps"] > 0
    assert "fps" not in json.dumps(artifact.attrs)


def test_pictures_are_png_files_of_what_they_are_called(result):
    artifact, _ = result
    pictures = StoredPictures.read(artifact).files
    assert {f"test/1/{kind}" for kind in ("truth", "render", "error", "edges", "depth")} <= set(pictures)
    truth, render = (cv2.imdecode(np.frombuffer(pictures[f"test/1/{k}"], np.uint8), cv2.IMREAD_COLOR) for k in ("truth", "render"))
    assert truth.shape == (40, 48, 3)
    assert np.median(truth.astype(int) - render) == pytest.approx(25.5, abs=1)
    assert sorted(view["stem"] for view in artifact.attrs["views"]) == ["test/1", "test/5", "val/3"]


def test_the_worst_views_are_shown_first_and_others_beside_them():
    rows = [{"frame": i, "psnr": psnr} for i, psnr in enumerate([30.0, 20.0, 40.0, 10.0, 35.0, 25.0, 45.0])]
    assert worst_and_others(rows, 4) == [3, 1, 5, 6]
    assert worst_and_others(rows, 100) == [3, 1, 5, 0, 4, 2, 6]
    assert worst_and_others(rows, 1) == [3] and worst_and_others(rows, 0) == []


def pictures_of(movie: bytes) -> np.ndarray:
    with av.open(io.BytesIO(movie)) as container:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])


def test_movies_show_the_truth_beside_the_render_and_a_turn(tmp_path):
    model = small_model(moving=True)
    frames = scene(tmp_path, [0, 2, 2, 2], model, offset=0.1, fixed=True)
    artifact, _ = evaluate(tmp_path, frames, fine=trained(tmp_path / "fine", model), movie_frames=3)
    movies = read_movies(artifact)
    assert set(movies) == {"over_time", "turntable"}
    beside, turn = pictures_of(movies["over_time"]), pictures_of(movies["turntable"])
    assert beside.shape == (3, 40, 96, 3) and turn.shape == (3, 40, 48, 3)
    truth, render = beside[:, :, :48].astype(int), beside[:, :, 48:]
    assert (truth - render).mean() == pytest.approx(25.5, abs=4), "the truth is 0.1 brighter"
    assert np.abs(np.diff(turn.astype(int), axis=0)).max() > 10


def test_no_movies_when_none_are_wanted_or_nothing_moves_in_time(tmp_path):
    model = small_model()
    fine = trained(tmp_path / "fine", model)
    artifact, _ = evaluate(tmp_path / "none", scene(tmp_path / "a", [0, 2, 2, 2], model), fine=fine, movie_frames=0)
    assert read_movies(artifact) == {}
    artifact, _ = evaluate(tmp_path / "two", scene(tmp_path / "b", [0, 2, 2], model), fine=fine, movie_frames=5)
    assert set(read_movies(artifact)) == {"turntable"}, "two pictures are no movie"


def test_a_perfect_model_reaches_the_limit_of_eight_bits(tmp_path):
    model = small_model()
    artifact, _ = evaluate(tmp_path, scene(tmp_path, [0, 2], model), coarse=trained(tmp_path / "coarse", model), max_views=0)
    test = artifact.attrs["metrics"]["splits"]["test"]
    assert test["psnr"] > 55 and test["ssim"] > 0.999
    assert StoredPictures.read(artifact).files == {} and artifact.attrs["views"] == []


def test_fine_wins_over_coarse_and_one_of_them_is_needed(tmp_path):
    model, empty = small_model(), small_model()
    for kind in (empty.gaussians, empty.convexes):
        kind.opacity_logits.data.fill_(-20.0)
    frames = scene(tmp_path, [0, 2], model)
    good, bad = trained(tmp_path / "good", model), trained(tmp_path / "bad", empty)
    first, _ = evaluate(tmp_path / "1", frames, coarse=bad, fine=good)
    second, _ = evaluate(tmp_path / "2", frames, coarse=bad)
    assert first.attrs["metrics"]["splits"]["test"]["psnr"] > second.attrs["metrics"]["splits"]["test"]["psnr"] + 10
    with pytest.raises(StageError, match="coarse and fine were skipped"):
        evaluate(tmp_path / "3", frames)


def test_nothing_held_out_measures_training_views_and_says_so(tmp_path):
    model = small_model()
    artifact, lines = evaluate(tmp_path, scene(tmp_path, [0, 0, 0], model), fine=trained(tmp_path / "fine", model))
    assert set(artifact.attrs["metrics"]["splits"]) == {"train"}
    assert any("training views are measured" in line for line in lines)
    assert artifact.attrs["metrics"]["protocol"]["notes"] == lines


def test_frames_without_a_pose_are_counted_and_left_out(tmp_path):
    model = small_model()
    frames = scene(tmp_path, [0, 2, 2], model, lost=(2,))
    artifact, lines = evaluate(tmp_path, frames, fine=trained(tmp_path / "fine", model))
    assert lines == ["1 of 2 test frames have no pose and are not measured"]
    assert artifact.attrs["metrics"]["splits"]["test"]["frames"] == 1
    with pytest.raises(StageError, match="no frame has a pose"):
        evaluate(tmp_path / "all", scene(tmp_path / "lost", [0, 2], model, lost=(0, 1)), fine=trained(tmp_path / "fine2", model))


def test_fixed_cameras_are_also_measured_after_an_affine_fit(tmp_path):
    model = small_model()
    frames = scene(tmp_path, [0, 2, 2, 2, 0], model, offset=0.08, fixed=True)
    artifact, _ = evaluate(tmp_path, frames, fine=trained(tmp_path / "fine", model))
    test = artifact.attrs["metrics"]["splits"]["test"]
    assert test["psnr_affine"] > test["psnr"] + 10 and test["ssim_affine"] >= test["ssim"]
    assert artifact.attrs["strip"]["times"] == [0.25, 0.5, 0.75]
    assert "strip/0/truth" in StoredPictures.read(artifact).files


def test_a_moving_model_gets_a_strip_from_one_standing_camera(tmp_path):
    model = small_model(moving=True)
    artifact, _ = evaluate(tmp_path, scene(tmp_path, [0, 2], model), fine=trained(tmp_path / "fine", model))
    assert len(artifact.attrs["strip"]["times"]) == 8
    files = StoredPictures.read(artifact).files
    assert "strip/7/render" in files and "strip/7/truth" not in files


def test_flow_is_shown_where_it_was_measured_and_only_there(result, tmp_path):
    assert "flow" not in result[0].attrs and not any(name.startswith("flow") for name in StoredPictures.read(result[0]).files)
    model = small_model()
    (tmp_path / "flow").mkdir()
    out = ArtifactWriter(tmp_path / "flow")
    values = {
        "pair": np.array([[0, 2]], np.int32),
        "forward": np.zeros((1, 40, 48, 2), np.float16),
        "confidence": np.full((1, 40, 48), 255, np.uint8),
        "edges": np.zeros((3, 40, 48), np.uint8),
    }
    for name, value in values.items():
        out.write(name, value)
    out.finish({})
    frames = scene(tmp_path, [0, 2, 0], model)
    artifact, _ = evaluate(tmp_path, frames, fine=trained(tmp_path / "fine", model), flow=Artifact(tmp_path / "flow"))
    assert [pair["frames"] for pair in artifact.attrs["flow"]["pairs"]] == [["frame 0", "frame 2"]]
    assert {"flow/0/frame", "flow/0/measured", "flow/0/rendered", "flow/0/edges", "flow/wheel"} <= set(StoredPictures.read(artifact).files)
    assert "flow" in Evaluate.inputs, "other flow is another key"


def test_lpips_with_weights_names_net_and_file(tmp_path, monkeypatch):
    generator = torch.Generator().manual_seed(0)
    state = {
        name: torch.randn(shape, generator=generator).abs() * 0.1 if "lin" in name else torch.randn(shape, generator=generator) * 0.1
        for name, shape in expected_shapes("alex").items()
    }
    weights = tmp_path / "alex.safetensors"
    save_file(state, weights)
    model = small_model()
    frames, fine = scene(tmp_path, [0, 2], model, offset=0.1), trained(tmp_path / "fine", model)
    artifact, _ = evaluate(tmp_path, frames, fine=fine, lpips_weights=weights)
    metrics = artifact.attrs["metrics"]
    assert metrics["splits"]["test"]["lpips"] > 0 and "lpips_reason" not in metrics["splits"]["test"]
    assert metrics["protocol"]["lpips_net"] == "alex"
    assert metrics["protocol"]["lpips_weights_blake3"] == blake3(weights.read_bytes()).hexdigest()
    loaded = Lpips.load(weights, "alex")
    monkeypatch.setattr("e4dgs.stages.evaluate.protocol.published_lpips", lambda net: loaded if net == "alex" else None)
    published = evaluate(tmp_path / "published", frames, fine=fine)[0].attrs["metrics"]
    assert published["splits"]["test"]["lpips"] == metrics["splits"]["test"]["lpips"]
    assert published["protocol"]["lpips_net"] == "alex" and "torchvision" in published["protocol"]["lpips_weights"]
    with pytest.raises(StageError, match=r"lpips_weights.*alex\.safetensors.*vgg"):
        evaluate(tmp_path / "vgg", frames, fine=fine, lpips_weights=weights, lpips_net="vgg")


def test_same_model_same_content(tmp_path):
    model = small_model()
    frames, fine = scene(tmp_path, [0, 2], model), trained(tmp_path / "fine", model)
    digests = [evaluate(tmp_path / str(k), frames, fine=fine)[0].digest for k in range(2)]
    assert digests[0] == digests[1]


def test_a_damaged_model_is_an_error_that_names_the_frame():
    frame = SimpleNamespace(color=torch.full((40, 48, 3), torch.nan))
    K, poses = cameras(1)
    frames = SimpleNamespace(K=K, cam_from_world=poses, width=48, height=40, time=[0.0], camera=[0], names=["r_007"], background=None)
    judge = Judge(SimpleNamespace(render=lambda *a: frame, near=0.01, clocks={}), frames, None, False)  # type: ignore[arg-type]
    with pytest.raises(StageError, match=r"'r_007'.*non-finite"):
        judge.render(0)


@pytest.mark.parametrize("times", [LEAST_TIMES - 1, LEAST_TIMES])
def test_what_moves_before_a_fixed_camera_is_measured_apart(times):
    """A white square of 10 x 10 px stands in one of the pictures, all else is 0.1 off; with few times nothing tells what moves."""
    pictures = np.full((times, 40, 48, 3), 51, np.uint8)
    pictures[0, 10:20, 10:20] = 255
    K, poses = cameras(times)
    many = {"camera": np.zeros(times, int), "registered": np.ones(times, bool), "time": np.linspace(0, 1, times)}
    names = [str(i) for i in range(times)]
    frames = SimpleNamespace(K=K, cam_from_world=poses, width=48, height=40, names=names, background=None, alpha=False, **many)
    frames.composited, frames.kept = lambda i: pictures[i], lambda i: None
    frame = Frame(torch.full((40, 48, 3), 0.3), *[torch.zeros(40, 48)] * 2, torch.zeros(40, 48, 0), *[torch.ones(1) > 0] * 2)
    judge = Judge(SimpleNamespace(render=lambda *a: frame, near=0.01, clocks={}), frames, None, True)  # type: ignore[arg-type]
    row = judge.measured(0, *judge.render(0))
    if times < LEAST_TIMES:
        assert (row["psnr_moving"], row["psnr_static"]) == (None, None)
        return
    rim = 14 * 14 - 10 * 10  # what lies within 2 px counts as moving too
    assert row["psnr_moving"] == pytest.approx(-10 * np.log10((100 * 0.7**2 + rim * 0.1**2) / 14**2), abs=1e-3)
    assert row["psnr_static"] == pytest.approx(20.0, abs=1e-3)


def test_means_leave_out_what_a_view_does_not_have():
    rows = [{"psnr": 20.0, "ssim": 0.5, "edge_psnr": None, "lpips": None}, {"psnr": 30.0, "ssim": 0.7, "edge_psnr": 18.0, "lpips": None}]
    assert means(rows) == {"psnr": 25.0, "ssim": pytest.approx(0.6), "edge_psnr": 18.0, "lpips": None}


def test_chosen_views_and_spread():
    frames = SimpleNamespace(split=np.array([0, 1, 2, 2]), registered=np.ones(4, bool))
    assert choose_views(frames, ("test",)) == ({"test": [2, 3]}, [])
    assert spread(range(10), 4) == [0, 3, 6, 9] and spread([5], 8) == [5] and spread(range(3), 0) == []


def test_the_plan_says_what_is_measured():
    facts = {"splits": {"train": 50, "val": 11, "test": 20}, "width": 400, "height": 400}
    assert Evaluate().applies(facts, EvaluateSettings()).reason == "11 val views, 20 test views"
    assert "training views" in Evaluate().applies({**facts, "splits": {"train": 5}}, EvaluateSettings()).reason
    assert Evaluate().estimate(facts, EvaluateSettings()) > 3


def test_error_and_depth_pictures():
    truth = np.zeros((8, 8, 3), np.uint8)
    color = np.zeros((8, 8, 3), np.float32)
    color[4:] = 0.3
    error = error_picture(color, truth).astype(int).sum(-1)
    assert error[0, 0] < 20 < error[7, 7]
    kept = np.ones((8, 8), bool)
    kept[7] = False
    assert (error_picture(color, truth, kept).astype(int).sum(-1)[7] == error[0, 0]).all(), "pixels that are not measured have no error"
    depth = np.full((8, 8), 2.0)
    depth[:, 4:] = 6.0
    alpha = np.ones((8, 8))
    alpha[0] = 0
    picture = depth_picture(depth, alpha)
    assert (picture[0] == 0).all() and (picture[3, 0] != picture[3, 7]).any()
    assert depth_range(depth, alpha) == pytest.approx([2.0, 6.0])
    assert not depth_picture(depth, np.zeros((8, 8))).any() and depth_range(depth, np.zeros((8, 8))) is None


@pytest.mark.parametrize(("test_camera", "looked_at"), [(False, 2), (True, 1)])
def test_flicker_is_measured_at_fixed_cameras_at_held_out_ones_where_there_are_any(test_camera, looked_at):
    """Two cameras, four times: the render is brighter by 5 levels at every second time, the truth is not."""
    camera, time = np.repeat([0, 1], 4), np.tile(np.linspace(0, 1, 4), 2)
    K, poses = cameras(8)
    split = np.where(camera == 1, 2, 0) if test_camera else np.zeros(8, int)
    values = {"camera": camera, "time": time, "split": split, "registered": np.ones(8, bool), "names": [str(i) for i in range(8)]}
    frames = SimpleNamespace(
        K=K, cam_from_world=poses, width=48, height=40, composited=lambda i: np.full((40, 48, 3), 51, np.uint8), **values
    )
    shown: list[int] = []

    def render(camera, at):
        shown.append(round(3 * at))
        color = torch.full((40, 48, 3), 0.2 + 5 / 255 * (shown[-1] % 2))
        return Frame(color, *[torch.zeros(40, 48)] * 2, torch.zeros(40, 48, 0), *[torch.ones(1) > 0] * 2)

    model = SimpleNamespace(render=render, near=0.01, clocks={}, motion=SimpleNamespace(static=False))
    found = measure_flicker(Judge(model, frames, None, True), frames)  # type: ignore[arg-type]
    assert found is not None and found["cameras"] == looked_at and found["pairs"] == 3 * looked_at
    assert found["static"] == pytest.approx(5.0, rel=1e-4) and found["edges"] is None and found["warped"] is None
    assert shown == [0, 1, 2, 3] * looked_at
    expected = [(one, step) for one in ([1] if test_camera else [0, 1]) for step in pairwise(np.linspace(0, 1, 4))]
    assert [(row["camera"], tuple(row["times"])) for row in found["per_pair"]] == expected
    assert np.mean([row["static"] for row in found["per_pair"]]) == found["static"] and found["per_pair"][0]["edges"] is None
    assert json.loads(json.dumps(found)) == found
    assert measure_flicker(Judge(model, frames, None, False), frames) is None  # type: ignore[arg-type]
    frames.registered[1::2] = False  # two times of each camera are too few
    assert measure_flicker(Judge(model, frames, None, True), frames) is None  # type: ignore[arg-type]


def test_only_as_many_views_are_measured_as_a_tenth_of_the_training_pays_for():
    assert most_measured(None, 400) == 32 and most_measured(None, 6000) == 120 and most_measured(None, 1600) == 32
    assert most_measured(None, 1650) == 33 and most_measured(7, 6000) == 7


def test_stretches_of_neighbours_cover_a_long_capture():
    assert stretches(range(10), 10) == [list(range(10))]
    parts = stretches(range(300), 48)
    assert [len(part) for part in parts] == [16, 16, 16] and parts[0][0] == 0 and parts[-1][-1] == 299
    assert all(b - a == 1 for part in parts for a, b in pairwise(part))


def test_views_are_rendered_by_one_thread_and_their_rows_come_in_order():
    """The first to be measured are the last to be done."""
    rendered = []

    class Slow:
        def render(self, i):
            rendered.append(threading.get_ident())
            return i, None

        def measured(self, i, color, frame):
            time.sleep(0.02 * (3 - i % 4))
            return {"frame": i, "color": color, "thread": threading.get_ident()}

    with ThreadPoolExecutor(4) as pool:
        rows = list(measured_rows(Slow(), range(3, 23), pool))
    assert [row["frame"] for row in rows] == [row["color"] for row in rows] == list(range(3, 23))
    assert set(rendered) == {threading.get_ident()} and threading.get_ident() not in {row["thread"] for row in rows}
