"""`e4dgs export flow`: the files of a real flow artifact, and what is said where there is none."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from e4dgs.pipeline import Artifact
from e4dgs.stages.shared.frameset import FrameSet
from e4dgs.vision.flow.colours import flow_colours
from e4dgs.workflows import cli
from flo_files import read_flo
from PIL import Image

SETTINGS = ("--set", "flow.max_pairs=3", "--set", "flow.preset=ultrafast", "--set", "frames.max_frames=4")


@pytest.fixture(autouse=True)
def keep_signals(monkeypatch):
    monkeypatch.setattr("signal.signal", lambda *args: None)


@pytest.fixture(scope="module")
def workspace(n3v_capture, tmp_path_factory) -> Path:
    """A workspace with flow of three fixed cameras, 80x64, 3 pairs."""
    folder = tmp_path_factory.mktemp("export") / "workspace"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("signal.signal", lambda *args: None)
        assert cli.main(["run", "flow", str(n3v_capture.root), "--workspace", str(folder), *SETTINGS]) == 0
    return folder


@pytest.fixture(scope="module")
def artifact(workspace) -> Artifact:
    return Artifact(next((workspace / "store" / "flow").iterdir()))


def pixels(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path))


@pytest.fixture(scope="module")
def exported(n3v_capture, workspace, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("exported") / "a" / "b"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("signal.signal", lambda *args: None)
        command = ["export", "flow", str(n3v_capture.root), "--workspace", str(workspace), "--out", str(out), "--largest", "2.5"]
        assert cli.main([*command, *SETTINGS]) == 0
    return out


def stems_of(workspace: Path, artifact: Artifact, capture: Path) -> tuple[FrameSet, list[str]]:
    frames = FrameSet(Artifact(next((workspace / "store" / "frames").iterdir())), capture)
    return frames, [re.sub("[^A-Za-z0-9._-]", "-", f"{frames.names[a]}_{frames.names[b]}") for a, b in artifact.read("pair")]


def test_every_pair_becomes_flo_and_png(n3v_capture, workspace, exported, artifact):
    _, stems = stems_of(workspace, artifact, n3v_capture.root)
    suffixes = (".flo", ".png", "_backward.flo", "_backward.png", "_edges.png", "_moving.png")
    assert len(stems) == 3
    made = {path.name for path in exported.iterdir()} - {"sequence.json"}
    assert made == {"wheel.png", *(stem + suffix for stem in stems for suffix in suffixes)}
    for direction, suffix in (("forward", ""), ("backward", "_backward")):
        for stem, flow in zip(stems, artifact.read(direction).astype(np.float32)):
            assert np.array_equal(read_flo(exported / f"{stem}{suffix}.flo"), flow)
            assert np.array_equal(pixels(exported / f"{stem}{suffix}.png"), flow_colours(flow, 2.5))


def test_overlays_colour_edges_and_what_moves_of_the_first_frame(n3v_capture, workspace, exported, artifact):
    frames, stems = stems_of(workspace, artifact, n3v_capture.root)
    edges, moving = artifact.read("edges"), artifact.read("moving")
    for stem, (first, _) in zip(stems, artifact.read("pair")):
        picture, mask = frames.composited(first), moving[first]
        shown = pixels(exported / f"{stem}_edges.png")
        assert (shown[edges[first] == 255] == (255, 40, 0)).all() and np.array_equal(shown[edges[first] == 0], picture[edges[first] == 0])
        shown = pixels(exported / f"{stem}_moving.png")
        assert np.abs(shown[mask == 255] - (picture[mask == 255] / 2 + np.array([0, 65, 127.5]))).max() < 1
        assert np.array_equal(shown[mask == 0], picture[mask == 0]) and 0 < (mask == 255).mean() < 1


def test_by_default_files_go_to_the_scene_and_the_scale_is_said(n3v_capture, workspace, capsys):
    command = ["export", "flow", str(n3v_capture.root), "--workspace", str(workspace), *SETTINGS]
    assert cli.main([*command, "--name", "other"]) == 0
    text = capsys.readouterr().out
    folder = workspace / "scenes" / "other" / "export" / "flow"
    assert f"flow: {folder}" in text and "3 pairs, 19 files; full colour is" in text
    assert len(list(folder.iterdir())) == 20, "and their index"
    first = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert cli.main([*command, "--name", "other"]) == 0, "the scene is known to belong to this capture"
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == first


def test_the_index_lists_frames_and_times_of_each_file(n3v_capture, workspace, exported, artifact):
    frames, stems = stems_of(workspace, artifact, n3v_capture.root)
    index = json.loads((exported / "sequence.json").read_text())
    assert set(index) == {".flo", ".png"} and index[".flo"]["format"] == "flow"
    files = [row["file"] for ending in index for row in index[ending]["files"]]
    assert {*files, "wheel.png", "sequence.json"} == {path.name for path in exported.iterdir()} and len(files) == len(set(files))
    for k, (first, second) in enumerate(artifact.read("pair")):
        row = index[".flo"]["files"][2 * k]
        assert (row["file"], row["frames"]) == (f"{stems[k]}.flo", [frames.names[first], frames.names[second]])
        assert row["time"] == [frames.time[first], frames.time[second]]
        assert row["seconds"] == pytest.approx([frames.seconds[k] - frames.seconds.min() for k in (first, second)])


def test_an_export_takes_the_place_of_an_earlier_one_and_of_nothing_else(n3v_capture, workspace, exported, tmp_path, capsys):
    out = shutil.copytree(exported, tmp_path / "out")
    index = json.loads((out / "sequence.json").read_text())
    for ending, name in ((".flo", "frame_1.flo"), (".png", "frame_1_edges.png"), (".flo", "../kept.flo")):
        index[ending]["files"].append({"file": name})
        (out / name).write_text("earlier")
    index[".ply"] = {"format": "mesh", "files": []}
    (out / "sequence.json").write_text(json.dumps(index))
    (out / "notes.txt").write_text("mine")
    command = ["export", "flow", str(n3v_capture.root), "--workspace", str(workspace), "--out", str(out), *SETTINGS]
    assert cli.main([*command, "--largest", "2.5"]) == 0
    assert {path.name for path in out.iterdir()} == {"notes.txt", *(path.name for path in exported.iterdir())}
    assert (tmp_path / "kept.flo").read_text() == "earlier" and ".ply" in json.loads((out / "sequence.json").read_text())
    (out / "photo_7.png").write_text("mine")
    capsys.readouterr()
    assert cli.main(command) == 2
    assert "it has photo_7.png, which no earlier export has listed there" in capsys.readouterr().err


def test_flow_that_is_not_there_names_the_command_that_makes_it(n3v_capture, tmp_path, capsys):
    command = ["export", "flow", str(n3v_capture.root), "--workspace", str(tmp_path / "my w"), "--preset", "fast", "--set", "flow.grow=2"]
    assert cli.main(command) == 2
    error = capsys.readouterr().err
    assert "never run for this scene" in error
    assert f"make it with: e4dgs run flow {n3v_capture.root} --workspace '{tmp_path}/my w' --preset fast --set flow.grow=2\n" in error
    assert not (tmp_path / "my w").exists()


def test_other_settings_are_another_flow(n3v_capture, workspace, capsys):
    command = ["export", "flow", str(n3v_capture.root), "--workspace", str(workspace), *SETTINGS, "--set", "flow.grow=9"]
    assert cli.main(command) == 2
    assert "settings.grow: 4 -> 9" in capsys.readouterr().err


def test_a_capture_without_flow_is_told_why(dnerf_capture, tmp_path, capsys):
    assert cli.main(["export", "flow", str(dnerf_capture.root), "--workspace", str(tmp_path / "w")]) == 2
    assert "this capture has no flow: every image has its own camera" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("--largest", "0"), 2, "--largest 0.0: give a positive number of px"),
        (("--largest", "nan"), 2, "--largest nan"),
        (("--out", "a file"), 2, "--out a file: this is a file; name a folder"),
        (("--out", "a file/below"), 1, "cannot be written"),
        (("--set", "flow.grou=9"), 2, "did you mean 'grow'?"),
    ],
)
def test_bad_arguments_say_what_is_wrong(arguments, code, message, n3v_capture, workspace, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("a file").write_text("mine")
    assert cli.main(["export", "flow", str(n3v_capture.root), "--workspace", str(workspace), *SETTINGS, *arguments]) == code
    error = capsys.readouterr().err
    assert error.startswith("error: ") and message in error and "Traceback" not in error and Path("a file").read_text() == "mine"


def test_damage_is_found_and_named(n3v_capture, workspace, tmp_path, capsys):
    copy = shutil.copytree(workspace, tmp_path / "copy")
    chunk = max((path for path in (copy / "store" / "flow").glob("*/forward/**/*") if path.is_file()), key=lambda p: p.stat().st_size)
    data = bytearray(chunk.read_bytes())
    data[len(data) // 2] ^= 0xFF
    chunk.write_bytes(data)
    command = ["export", "flow", str(n3v_capture.root), "--workspace", str(copy), "--out", str(tmp_path / "out"), *SETTINGS]
    assert cli.main(command) == 1
    error = capsys.readouterr().err
    assert "array 'forward'" in error and "is damaged" in error and "--force" in error
    assert not list((tmp_path / "out").glob(".*")), "nothing half-written is left"


def test_an_export_imports_no_torch(n3v_capture, workspace, tmp_path):
    command = ["export", "flow", str(n3v_capture.root), "--workspace", str(workspace), "--out", str(tmp_path / "out"), *SETTINGS]
    code = f"import sys; from e4dgs.workflows.cli import main; print(main({command!r}), 'torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "0 False"
