"""The strip of flow in an evaluation: which pairs it shows, on which scale, and how far rendered flow is from measured."""

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from e4dgs.pipeline import Artifact, ArtifactWriter
from e4dgs.scene.losses.flow_loss import rendered_flow
from e4dgs.scene.model import Model
from e4dgs.scene.motion.static import Static
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.stages.evaluate.artifact import StoredPictures
from e4dgs.stages.evaluate.judge import Judge
from e4dgs.stages.evaluate.pictures.book import PictureBook
from e4dgs.stages.evaluate.pictures.flow import add_flow, difference
from e4dgs.stages.flow.artifact import StoredFlow
from e4dgs.vision.flow.colours import flow_colours

WIDTH, HEIGHT, COUNT = 48, 40, 8


def make_judge(held_out: tuple[int, ...] = ()) -> Judge:
    """A still, nearly opaque blob before a camera that slides to the left: everything drawn flows to the right."""
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (60, 3)).astype(np.float32)
    model = Model(
        GaussianSet.from_points(points, np.full((60, 3), 0.5, np.float32), 0),
        ConvexSet.from_points(np.zeros((0, 6, 3), np.float32), np.zeros((0, 3), np.float32), 0),
        Static(),
        0,
    )
    model.gaussians.opacity_logits.data.fill_(3.0)
    poses = np.tile(np.eye(4), (COUNT, 1, 1))
    poses[:, 2, 3], poses[:, 0, 3] = 4.0, 0.2 * np.arange(COUNT)
    split = np.zeros(COUNT, np.uint8)
    split[list(held_out)] = 2
    frames = SimpleNamespace(
        K=np.tile(np.array([[50.0, 0, 24], [0, 50, 20], [0, 0, 1]]), (COUNT, 1, 1)),
        cam_from_world=poses,
        width=WIDTH,
        height=HEIGHT,
        background="black",
        names=[f"frame {i}" for i in range(COUNT)],
        time=np.linspace(0, 1, COUNT),
        camera=np.arange(COUNT) // 4,
        train=np.flatnonzero(split == 0),
        composited=lambda i: np.full((HEIGHT, WIDTH, 3), 10 * i, np.uint8),
    )
    return Judge(model, frames, None, False)  # type: ignore[arg-type]


def flow_of(judge: Judge, pairs: list[tuple[int, int]], folder: Path, offset: float = 0.0, moving: object = None) -> Artifact:
    """What the model itself renders, ``offset`` px further right, as if it had been measured; camera 1 has a mask."""
    folder.mkdir(parents=True)
    out = ArtifactWriter(folder)
    measured = []
    for a, b in pairs:
        with torch.no_grad():
            flow, _ = rendered_flow(judge.model, judge.camera(a), float(judge.frames.time[a]), judge.camera(b), float(judge.frames.time[b]))
        measured.append(flow.numpy() + np.array([offset, 0]))
    confidence = np.full((len(pairs), HEIGHT, WIDTH), 255, np.uint8)
    confidence[:, : HEIGHT // 2] = 0
    edges = np.zeros((COUNT, HEIGHT, WIDTH), np.uint8)
    edges[np.arange(COUNT), 5, np.arange(COUNT)] = 255  # frame i has its edge at column i
    values = {
        "pair": np.array(pairs, np.int32).reshape(-1, 2),
        "forward": np.array(measured, np.float16),
        "backward": -np.array(measured, np.float16),
        "confidence": confidence,
        "edges": edges,
        "ever_moving": np.full((1, HEIGHT, WIDTH), 255, np.uint8),
    }
    for name, value in values.items():
        out.write(name, value)
    if moving is not None:
        out.write("moving", moving)
    out.attrs.update(ever_moving_cameras=[1], method="dis-medium")
    out.finish({})
    return Artifact(folder)


def strip(judge: Judge, flow: Artifact, folder: Path, most: int = 8) -> tuple[dict, dict[str, np.ndarray]]:
    """attrs `flow` and the decoded pictures, RGB."""
    book = PictureBook(640)
    add_flow(book, judge, StoredFlow(flow), most)
    folder.mkdir()
    out = ArtifactWriter(folder)
    book.stored.write(out)
    out.finish({})
    artifact = Artifact(folder)
    files = StoredPictures.read(artifact).files
    pictures = {name: cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1] for name, data in files.items()}
    return artifact.attrs.get("flow", {}), pictures


def test_a_strip_shows_frame_measured_rendered_edges_and_what_moves(tmp_path):
    judge = make_judge()
    flow = flow_of(judge, [(0, 1), (4, 5)], tmp_path / "flow")
    shown, pictures = strip(judge, flow, tmp_path / "out")
    assert set(pictures) == {
        *(f"flow/{k}/{kind}" for k in range(2) for kind in ("frame", "measured", "rendered", "edges")),
        "flow/1/moving",  # camera 0 has no mask
        "flow/wheel",
    }
    assert shown["method"] == "dis-medium" and [pair["stem"] for pair in shown["pairs"]] == ["flow/0", "flow/1"]
    assert shown["pairs"][1]["frames"] == ["frame 4", "frame 5"] and shown["pairs"][1]["times"] == pytest.approx([4 / 7, 5 / 7])
    assert (pictures["flow/1/frame"] == 40).all()
    measured = flow.read("forward").astype(np.float32)
    for k in range(2):
        assert np.array_equal(pictures[f"flow/{k}/measured"], flow_colours(measured[k], shown["largest"]))
    middle = (HEIGHT // 2, WIDTH // 2)
    red, green, blue = (int(c) for c in pictures["flow/0/rendered"][middle])
    assert red > 180 and green < 120 and blue < 120, "it flows to the right"
    assert (pictures["flow/0/rendered"][0, 0] == 255).all(), "the background does not move"
    assert pictures["flow/1/edges"][5, 4].tolist() == [255, 40, 0] and (pictures["flow/1/edges"][5, 5] == 40).all()
    assert pictures["flow/1/moving"][0, 0].tolist() == [20, 85, 148]


def test_a_frame_shows_its_own_mask_where_it_has_one(tmp_path):
    judge = make_judge()
    moving = np.zeros((COUNT, HEIGHT, WIDTH), np.uint8)
    moving[4, 0, 0] = 255
    _, pictures = strip(judge, flow_of(judge, [(0, 1), (4, 5)], tmp_path / "flow", moving=moving), tmp_path / "out")
    assert pictures["flow/1/moving"][0, 0].tolist() == [20, 85, 148] and (pictures["flow/1/moving"][0, 1] == 40).all()
    assert (pictures["flow/0/moving"] == 0).all(), "a mask of nothing shows the frame"


def test_only_pairs_of_training_frames_are_shown(tmp_path):
    judge = make_judge(held_out=(1, 6))
    flow = flow_of(judge, [(0, 1), (1, 2), (2, 3), (5, 6)], tmp_path / "flow")
    shown, pictures = strip(judge, flow, tmp_path / "out")
    assert [pair["frames"] for pair in shown["pairs"]] == [["frame 2", "frame 3"]]
    assert not any(name.startswith("flow/1/") for name in pictures)


def test_rendered_flow_fades_where_the_background_shows_through(tmp_path):
    judge = make_judge()
    shown, pictures = strip(judge, flow_of(judge, [(0, 1)], tmp_path / "flow"), tmp_path / "out")
    with torch.no_grad():
        flow, alpha = rendered_flow(judge.model, judge.camera(0), 0.0, judge.camera(1), 1 / 7)
    assert ((alpha > 0.05) & (alpha < 0.4)).sum() > 20, "the blob has soft borders"
    faded = flow * (2 * alpha).clamp(max=1)[..., None]
    wanted = flow_colours(faded.numpy(), shown["largest"]).astype(int)
    assert np.abs(pictures["flow/0/rendered"] - wanted).max() <= 1


@pytest.mark.parametrize(("most", "first"), [(8, [0, 2, 4, 6]), (2, [0, 6]), (1, [0])])
def test_pairs_are_few_and_evenly_spread(most, first, tmp_path):
    judge = make_judge()
    shown, _ = strip(judge, flow_of(judge, [(i, i + 1) for i in range(7)], tmp_path / "flow"), tmp_path / "out", most)
    assert [pair["frames"][0] for pair in shown["pairs"]] == [f"frame {i}" for i in first]


@pytest.mark.parametrize(("pairs", "most"), [([], 8), ([(0, 1)], 0)])
def test_nothing_to_show_leaves_nothing_behind(pairs, most, tmp_path):
    judge = make_judge()
    shown, pictures = strip(
        judge, flow_of(judge, [(0, 1)], tmp_path / "flow") if pairs else empty_flow(tmp_path / "flow"), tmp_path / "out", most
    )
    assert shown == {} and pictures == {}


def empty_flow(folder: Path) -> Artifact:
    folder.mkdir()
    out = ArtifactWriter(folder)
    out.write("pair", np.zeros((0, 2), np.int32))
    out.finish({})
    return Artifact(folder)


@pytest.mark.parametrize("offset", [0.0, 1.5])
def test_the_difference_is_that_of_the_flows_where_both_are_known(offset, tmp_path):
    judge = make_judge()
    shown, _ = strip(judge, flow_of(judge, [(0, 1)], tmp_path / "flow", offset), tmp_path / "out")
    pair = shown["pairs"][0]
    assert pair["difference"] == pytest.approx(offset, abs=2e-3)  # flow is stored in half floats
    assert pair["motion"] == pytest.approx(2.5 + offset, abs=0.4)  # 50 px * 0.2 / 4


def test_what_does_not_count_does_not_enter_the_difference():
    measured, rendered = np.zeros((2, 2, 2)), np.zeros((2, 2, 2))
    measured[0, 0] = (3, 4)
    measured[0, 1], rendered[1, 0] = 1e5, np.nan
    counts, edges = np.array([[True, False], [True, True]]), np.array([[True, True], [True, False]])
    assert difference(measured, rendered, counts, edges) == {"difference": 2.5, "motion": 2.5, "at_edges": 5.0}
    assert difference(measured, rendered, counts, ~edges) == {"difference": 2.5, "motion": 2.5, "at_edges": 0.0}
    nothing = np.zeros((2, 2), bool)
    assert difference(measured, rendered, nothing, edges) == {"difference": None, "motion": None, "at_edges": None}
