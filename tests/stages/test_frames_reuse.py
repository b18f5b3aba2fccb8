"""`frames` decodes a video once: a camera more leaves the pictures of the others as they were, byte for byte."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from e4dgs.pipeline import Graph, Job, Outcome, Records, Runner, Store, build_settings, make_plan
from e4dgs.stages.frames import videos
from e4dgs.stages.frames.settings import FramesSettings, recognise_for
from e4dgs.stages.frames.stage import Frames
from PIL import Image


@pytest.fixture
def decoded(monkeypatch) -> list[str]:
    """The files that were decoded to the end, in order."""
    found: list[str] = []
    original = videos.decode
    monkeypatch.setattr(videos, "decode", lambda root, one, *rest: found.append(one.file) or original(root, one, *rest))
    return found


def rig(source: Path, folder: Path, *names: str) -> Path:
    """Some cameras of a rig, with their poses."""
    folder.mkdir(exist_ok=True)
    for name in names:
        shutil.copy(source / name, folder / name)
    every = sorted(path.name for path in source.glob("*.mp4"))
    there = sorted(path.name for path in folder.glob("*.mp4"))
    if (source / "poses_bounds.npy").exists():
        np.save(folder / "poses_bounds.npy", np.load(source / "poses_bounds.npy")[[every.index(name) for name in there]])
    return folder


def job(workspace: Path, path: Path, **settings: Any) -> Job:
    graph = Graph([Frames()])
    built = build_settings(graph.settings, [(f"frames.{name}", value) for name, value in settings.items()])
    options = built["frames"]
    assert isinstance(options, FramesSettings)
    return Job(graph, recognise_for(path, options), built, Store(workspace / "store"), Records(workspace / "records"))


def run(job: Job, lines: list[str] | None = None) -> Outcome:
    return Runner(job, (lines if lines is not None else []).append).run()[0]


def test_a_camera_more_is_decoded_alone(n3v_capture, tmp_path, decoded):
    """It comes between the others: their pictures have other numbers in the new result."""
    path = rig(n3v_capture.root, tmp_path / "rig", "cam00.mp4", "cam03.mp4")
    first = run(job(tmp_path, path))
    assert decoded == ["cam00.mp4", "cam03.mp4"]
    rig(n3v_capture.root, path, "cam01.mp4")
    (row,) = make_plan(job(tmp_path, path))
    assert row.reason == "the content of the capture's files changed; 1 of 3 cameras are new"
    whole = Frames().estimate(job(tmp_path, path).capture.facts, FramesSettings())
    assert row.estimate is not None and whole is not None and 0.5 < row.estimate < whole
    decoded.clear()
    lines: list[str] = []
    second = run(job(tmp_path, path), lines)
    assert decoded == ["cam01.mp4"] and "  frames: 2 of 3 cameras as decoded before" in lines
    assert second.artifact.provenance["earlier"] == first.artifact.path.name
    fresh = run(job(tmp_path / "fresh", path))
    assert decoded[1:] == ["cam00.mp4", "cam01.mp4", "cam03.mp4"]
    assert second.artifact.digest == fresh.artifact.digest and second.artifact.info["videos"] == fresh.artifact.info["videos"]
    second.artifact.verify()


def test_a_camera_that_is_filmed_again_or_renamed_is_told_by_its_content(n3v_capture, tmp_path, decoded):
    path = rig(n3v_capture.root, tmp_path / "rig", "cam00.mp4", "cam01.mp4", "cam02.mp4")
    run(job(tmp_path, path))
    shutil.copy(path / "cam02.mp4", path / "cam04.mp4")
    shutil.copy(n3v_capture.root / "cam03.mp4", path / "cam02.mp4")
    np.save(path / "poses_bounds.npy", np.load(n3v_capture.root / "poses_bounds.npy"))
    decoded.clear()
    outcome = run(job(tmp_path, path))
    assert decoded == ["cam02.mp4"] and outcome.artifact.digest == run(job(tmp_path / "fresh", path)).artifact.digest


def test_poses_alone_leave_every_picture(n3v_capture, tmp_path, decoded):
    path = rig(n3v_capture.root, tmp_path / "rig", "cam00.mp4", "cam01.mp4")
    run(job(tmp_path, path))
    poses = np.load(path / "poses_bounds.npy")
    poses[:, 3] += 0.1
    np.save(path / "poses_bounds.npy", poses)
    decoded.clear()
    outcome = run(job(tmp_path, path))
    assert decoded == [] and outcome.reason.endswith("; 0 of 2 cameras are new")
    assert outcome.artifact.digest == run(job(tmp_path / "fresh", path)).artifact.digest


def test_other_frames_of_the_same_files_are_decoded(n3v_capture, tmp_path, decoded):
    path = rig(n3v_capture.root, tmp_path / "rig", "cam00.mp4", "cam01.mp4")
    run(job(tmp_path, path))
    decoded.clear()
    lines: list[str] = []
    run(job(tmp_path, path, every=2), lines)
    assert decoded == ["cam00.mp4", "cam01.mp4"] and not any("decoded before" in line for line in lines)


@pytest.mark.parametrize("when", ["before", "meanwhile"])
def test_damage_is_found_and_decoded_again(n3v_capture, tmp_path, decoded, monkeypatch, when):
    path = rig(n3v_capture.root, tmp_path / "rig", "cam00.mp4", "cam01.mp4")
    chunk = run(job(tmp_path, path)).artifact.path / "images" / "c" / "7" / "0" / "0" / "0"

    def spoil() -> None:
        chunk.write_bytes(chunk.read_bytes()[:-1] + b"x")

    original = Frames.run
    if when == "before":
        spoil()
    else:  # after every byte has been found sound
        monkeypatch.setattr(Frames, "run", lambda self, ctx: [spoil(), original(self, ctx)])
    rig(n3v_capture.root, path, "cam03.mp4")
    decoded.clear()
    outcome = run(job(tmp_path, path))
    assert decoded == (["cam00.mp4"] if when == "before" else []) + ["cam01.mp4", "cam03.mp4"]
    monkeypatch.setattr(Frames, "run", original)
    assert outcome.artifact.digest == run(job(tmp_path / "fresh", path)).artifact.digest


def test_pictures_in_files_have_nothing_to_take_over(tmp_path):
    path = tmp_path / "pictures"
    path.mkdir()
    for k in range(4):
        Image.new("RGB", (32, 24), (40 * k, 0, 0)).save(path / f"{k:03d}.png")
    outcome = run(job(tmp_path, path))
    assert outcome.artifact.provenance["items"] == [] and "videos" not in outcome.artifact.info
    Image.new("RGB", (32, 24)).save(path / "004.png")
    assert run(job(tmp_path, path)).reason == "the content of the capture's files changed"
