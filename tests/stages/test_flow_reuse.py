"""A capture that grows has the flow of its new pairs measured and nothing else, and comes out as if it had been measured afresh."""

import json
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from e4dgs.pipeline import Applies, Graph, Job, Outcome, Records, Runner, Settings, Stage, Store, build_settings, make_plan
from e4dgs.stages.flow import scout as flow_scout
from e4dgs.stages.flow.stage import Flow
from e4dgs.stages.frames.settings import FramesSettings, recognise_for
from e4dgs.stages.frames.stage import Frames
from e4dgs.stages.poses.artifact import StoredPoses
from e4dgs.vision.flow.method import Dis
from factory import Options, make, write_n3v
from factory.writers import write_mp4
from other_code import edit

HEIGHT, WIDTH = 64, 96


class Cameras(Stage):
    """Stands for structure from motion: more frames give slightly other poses, and another lens."""

    name = "poses"
    inputs = ("frames",)
    settings = Settings

    def applies(self, facts: Any, settings: Settings) -> Applies:
        return Applies.no("the files hold poses") if facts["poses"] else Applies.yes()

    def run(self, ctx: Any) -> None:
        count = len(ctx.inputs["frames"].read("camera"))
        K = np.array([[90.0 + 0.1 * count, 0, WIDTH / 2], [0, 90.0 + 0.1 * count, HEIGHT / 2], [0, 0, 1]])
        poses = np.tile(np.eye(4), (count, 1, 1))
        poses[:, 0, 3] = -0.02 * np.arange(count) * (1 + 0.001 * count)
        StoredPoses(
            K=np.tile(K, (count, 1, 1)),
            lens_K=np.tile(K * np.array([0.95, 0.95, 1])[:, None], (count, 1, 1)),
            cam_from_world=poses,
            distortion=np.tile([-0.05 - 1e-4 * count, 0, 0, 0], (count, 1)),
            registered=np.ones(count, bool),
            points=np.zeros((1, 3)),
            point_colors=np.zeros((1, 3), np.uint8),
            point_errors=np.zeros(1),
        ).write(ctx.out)


def pictures(count: int, first: int = 0) -> list[np.ndarray]:
    """A textured wall that slides by 2 px a frame, and a disk before it that goes the other way."""
    noise = np.random.default_rng(5).integers(0, 256, (HEIGHT // 4, 64, 3), dtype=np.uint8)
    wall = cv2.resize(noise, (256, HEIGHT), interpolation=cv2.INTER_CUBIC)
    found = []
    for k in range(first, first + count):
        picture = np.ascontiguousarray(np.roll(wall, 2 * k, 1)[:, :WIDTH])
        cv2.circle(picture, (70 - 2 * k % 50, 30), 9, (240, 40, 40), -1)
        found.append(picture)
    return found


def video(root: Path, frames: list[np.ndarray], name: str = "clip.mp4") -> Path:
    """Lossless, so that more frames change none of the others."""
    root.mkdir(parents=True, exist_ok=True)
    write_mp4(root / name, iter(frames), 30, 0)
    return root / name


def posed(root: Path, frames: list[np.ndarray], k1: float = 0.0) -> Path:
    """Pictures and poses in files."""
    (root / "images").mkdir(parents=True, exist_ok=True)
    listed = []
    for k, picture in enumerate(frames):
        cv2.imwrite(str(root / "images" / f"{k:03d}.png"), picture[..., ::-1])
        pose = np.eye(4)
        pose[0, 3] = 0.02 * k
        listed.append({"file_path": f"images/{k:03d}.png", "time": float(k), "transform_matrix": pose.tolist()})
    lens = {"fl_x": 90.0, "fl_y": 90.0, "cx": WIDTH / 2, "cy": HEIGHT / 2, "w": WIDTH, "h": HEIGHT, "k1": k1}
    (root / "transforms.json").write_text(json.dumps({**lens, "camera_model": "OPENCV", "frames": listed}))
    return root


@pytest.fixture
def measured(monkeypatch) -> list[int]:
    """One entry for every flow that DIS measures; the glance of `scout` is not one."""
    found: list[int] = []
    original = Dis._flow
    monkeypatch.setattr(Dis, "_flow", lambda self, a, b: found.append(1) or original(self, a, b))
    return found


def job(workspace: Path, path: Path, also: list[Store] | None = None, **settings) -> Job:
    graph = Graph([Frames(), Cameras(), Flow()])
    chosen = {"frames.holdout": 0, "flow.detect_static": False, **{name.replace("__", "."): value for name, value in settings.items()}}
    built = build_settings(graph.settings, chosen.items())
    frames = built["frames"]
    assert isinstance(frames, FramesSettings)
    capture = recognise_for(path, frames)
    return Job(graph, capture, built, Store(workspace / "store"), Records(workspace / "records" / path.stem), also=also or [])


def run(job: Job, lines: list[str] | None = None) -> Outcome:
    return Runner(job, (lines if lines is not None else []).append).run()[-1]


def fresh(tmp_path: Path, path: Path, **settings) -> str:
    """The digest of `flow` in an empty store."""
    return run(job(tmp_path / "fresh", path, **settings)).artifact.digest


def test_more_frames_of_a_video_leave_the_others_flow_as_it_was(tmp_path, measured):
    """Structure from motion finds other poses and another lens, which the flow of a pair does not depend on."""
    first = run(job(tmp_path, video(tmp_path, pictures(8))))
    assert len(measured) == 2 * 7 and first.artifact.info["pairs"] == {"measured": 7, "taken_over": 0}
    path = video(tmp_path, pictures(11))
    before = make_plan(job(tmp_path, path))[-1].reason
    assert before.endswith("after frames, poses; of 7 pairs made before, those that are unchanged are reused")
    Runner(job(tmp_path, path)).run(["poses"])
    planned = make_plan(job(tmp_path, path))[-1]
    assert planned.reason.endswith("; 3 of 10 pairs are new") and planned.estimate is not None

    measured.clear()
    lines: list[str] = []
    second = run(job(tmp_path, path), lines)
    assert len(measured) == 2 * 3 and second.artifact.info["pairs"] == {"measured": 3, "taken_over": 7}
    assert "  flow: flow of 7 of 10 pairs is reused from an earlier result; that of 3 was measured" in lines
    assert second.artifact.provenance["earlier"] == first.artifact.path.name
    assert {"lens_forward", "moving"} <= set(second.artifact.names())
    assert second.artifact.digest == fresh(tmp_path, path)


def test_frames_before_and_between_are_recognised_under_other_numbers_times_and_names(tmp_path, measured):
    old = pictures(6, first=2)
    run(job(tmp_path, video(tmp_path, old, "short.mp4")))
    both = [*pictures(2), *old[:3], pictures(1, first=30)[0], *old[3:]]
    measured.clear()
    path = video(tmp_path, both, "long.mp4")
    outcome = run(job(tmp_path, path))
    assert outcome.artifact.info["pairs"] == {"measured": 4, "taken_over": 4} and len(measured) == 2 * 4
    assert outcome.artifact.digest == fresh(tmp_path, path)


@pytest.mark.parametrize("k1", [0.0, -0.05])
def test_pictures_in_files_are_told_by_their_content(tmp_path, measured, k1):
    run(job(tmp_path, posed(tmp_path / "capture", pictures(6), k1)))
    path = posed(tmp_path / "capture", pictures(8), k1 * 1.01)
    measured.clear()
    outcome = run(job(tmp_path, path))
    assert len(measured) == 2 * 2 and outcome.reason.endswith("2 of 7 pairs are new")
    assert ("lens_forward" in outcome.artifact) == (k1 != 0)
    assert outcome.artifact.digest == fresh(tmp_path, path)


def test_a_lens_that_is_found_later_needs_no_other_flow(tmp_path, measured):
    run(job(tmp_path, posed(tmp_path / "capture", pictures(6))))
    path = posed(tmp_path / "capture", pictures(6), -0.05)
    measured.clear()
    outcome = run(job(tmp_path, path))
    assert not measured and outcome.artifact.digest == fresh(tmp_path, path)


def test_a_damaged_result_is_measured_again_and_never_believed(tmp_path, measured):
    first = run(job(tmp_path, posed(tmp_path / "capture", pictures(6))))
    chunk = first.artifact.path / "forward" / "c" / "2" / "0" / "0" / "0"
    chunk.write_bytes(chunk.read_bytes()[:-1] + b"x")
    path = posed(tmp_path / "capture", pictures(8))
    measured.clear()
    lines: list[str] = []
    outcome = run(job(tmp_path, path), lines)
    assert len(measured) == 2 * 7 and outcome.artifact.digest == fresh(tmp_path, path)
    assert any("forward/c/2/0/0/0" in line and "nothing is reused" in line for line in lines)


def test_a_chunk_that_spoils_while_it_is_used_is_measured(tmp_path, measured, monkeypatch):
    """After every byte has been found sound."""
    run(job(tmp_path, posed(tmp_path / "capture", pictures(6))))
    original = Flow.run

    def spoiled(self, ctx: Any) -> None:
        chunk = ctx.earlier.artifact.path / "backward" / "c" / "1" / "0" / "0" / "0"
        chunk.write_bytes(chunk.read_bytes()[:-1] + b"x")
        original(self, ctx)

    monkeypatch.setattr(Flow, "run", spoiled)
    path = posed(tmp_path / "capture", pictures(8))
    measured.clear()
    outcome = run(job(tmp_path, path))
    assert outcome.artifact.info["pairs"] == {"measured": 3, "taken_over": 4} and len(measured) == 2 * 3
    monkeypatch.setattr(Flow, "run", original)
    assert outcome.artifact.digest == fresh(tmp_path, path)


@pytest.mark.parametrize("what", ["setting", "code"])
def test_another_setting_or_other_code_measures_everything(tmp_path, measured, monkeypatch, what):
    run(job(tmp_path, posed(tmp_path / "capture", pictures(6))))
    path, settings = posed(tmp_path / "capture", pictures(8)), {}
    if what == "setting":
        settings = {"flow__preset": "fast"}
    else:
        edit(monkeypatch, Flow, "vision/flow/method.py")
    measured.clear()
    outcome = run(job(tmp_path, path, **settings))
    assert len(measured) == 2 * 7 and "are new" not in outcome.reason


def test_flow_of_another_size_is_not_taken_over(tmp_path, measured, monkeypatch):
    """The size follows from the motion in the whole capture, which no plan knows."""
    run(job(tmp_path, posed(tmp_path / "capture", pictures(6))))
    path = posed(tmp_path / "capture", pictures(8))
    monkeypatch.setattr("e4dgs.stages.flow.pairs.working_size", lambda *arguments: (flow_scout.ENOUGH // 6, 1.0))
    measured.clear()
    lines: list[str] = []
    run(job(tmp_path, path), lines)
    assert len(measured) == 2 * 7
    assert any("the earlier result was measured with dis-medium at 96 px" in line and "nothing is reused" in line for line in lines)


def test_where_nothing_moves_there_is_no_flow_to_take_over(tmp_path, measured, monkeypatch):
    static = SimpleNamespace(static=True, reason="all of it stands still", largest_moving_share=0.0)
    monkeypatch.setattr("e4dgs.stages.flow.run.static_scene", lambda *arguments: static)
    run(job(tmp_path, posed(tmp_path / "capture", pictures(6)), flow__detect_static=True))
    monkeypatch.setattr("e4dgs.stages.flow.run.static_scene", lambda *arguments: SimpleNamespace(**{**vars(static), "static": False}))
    outcome = run(job(tmp_path, posed(tmp_path / "capture", pictures(8)), flow__detect_static=True))
    assert "are new" not in outcome.reason and len(measured) == 2 * 7


def test_a_camera_more_leaves_the_flow_of_the_others_as_it_was(tmp_path, measured):
    """The cameras of a rig stand still, so that masks of what changes before them are made, too."""
    options = Options(backdrop="room", rig="arc", cameras=4, times=4, motion=0.4, width=96, height=72, samples=1, fov_degrees=60.0)
    path = write_n3v(make(options), tmp_path / "all").root
    few = tmp_path / "few"
    few.mkdir()
    for name in ("cam00.mp4", "cam01.mp4", "cam02.mp4"):
        shutil.copy(path / name, few / name)
    np.save(few / "poses_bounds.npy", np.load(path / "poses_bounds.npy")[:3])
    first = run(job(tmp_path, few))
    assert first.artifact.info["pairs"] == {"measured": 9, "taken_over": 0}
    measured.clear()
    outcome = run(job(tmp_path, path))
    assert outcome.artifact.info["pairs"] == {"measured": 3, "taken_over": 9} and len(measured) == 2 * 3
    assert outcome.reason.endswith("3 of 12 pairs are new") and "ever_moving" in outcome.artifact
    assert outcome.artifact.digest == fresh(tmp_path, path)


def test_another_workspace_lends_its_pairs(tmp_path, measured):
    run(job(tmp_path / "theirs", posed(tmp_path / "capture", pictures(6))))
    path = posed(tmp_path / "capture", pictures(8))
    measured.clear()
    outcome = run(job(tmp_path / "ours", path, [Store(tmp_path / "theirs" / "store")]))
    assert len(measured) == 2 * 2 and outcome.artifact.digest == fresh(tmp_path, path)
