"""Commands that look at results know the last run: nobody repeats its options, and nobody is told to train again for a forgotten one."""

import json
import shutil
from pathlib import Path

import pytest
from e4dgs.workflows.cli import main
from e4dgs.workflows.last_run import KEPT, Run, last_run, runs_of
from e4dgs.workflows.results import words_of
from e4dgs.workflows.session import Choice, Options

QUICK = ["--set", "coarse.iterations=5", "--set", "hulls.budget=0", "--set", "fine.iterations=0", "--device", "cpu"]


@pytest.fixture(scope="module")
def ran(dnerf_capture, tmp_path_factory):
    """A capture whose last run had options, and its workspace."""
    workspace = tmp_path_factory.mktemp("last") / "ws"
    assert main(["run", "all", str(dnerf_capture.root), "--workspace", str(workspace), *QUICK]) == 0
    return dnerf_capture.root, workspace


def scene(workspace):
    (folder,) = (workspace / "scenes").iterdir()
    return folder


def test_a_command_without_options_takes_the_last_run(ran, tmp_path, capsys):
    capture, workspace = ran
    ply = ["export", "ply", "--times", "1", "--workspace", str(workspace)]
    for k, named in enumerate(([str(capture)], [str(scene(workspace))], [scene(workspace).name], [])):
        assert main([*ply, *named, "--out", str(tmp_path / str(k))]) == 0, capsys.readouterr().err
    files = [next((tmp_path / str(k)).rglob("*.ply")).read_bytes() for k in range(4)]
    assert len(set(files)) == 1
    assert "coarse.iterations=5" in capsys.readouterr().err  # it says whose options it took


def test_a_scenes_folder_needs_no_workspace(ran, tmp_path):
    _, workspace = ran
    out = tmp_path / "out"
    assert main(["render", str(scene(workspace)), "--path", "turntable", "--frames", "2", "--size", "16", "--out", str(out)]) == 0
    assert len(list(out.iterdir())) == 2


def test_a_scenes_folder_and_another_workspace_contradict_each_other(ran, tmp_path, capsys):
    _, workspace = ran
    for command in (["plan"], ["report"], ["store", "pin"]):
        assert main([*command, str(scene(workspace)), "--workspace", str(tmp_path / "elsewhere")]) == 2
        said = capsys.readouterr().err
        assert f"is a scene of {workspace}; give --workspace {workspace}, or the capture itself" in said, said
    assert not (tmp_path / "elsewhere").exists()
    assert main(["plan", str(scene(workspace)), "--workspace", str(workspace)]) == 0


def test_an_empty_folder_does_not_hide_a_scene_of_its_name(ran, tmp_path, monkeypatch, capsys):
    _, workspace = ran
    monkeypatch.chdir(tmp_path)
    name = scene(workspace).name
    (tmp_path / name).mkdir()
    assert main(["report", name, "--workspace", str(workspace)]) == 0, capsys.readouterr().err
    (tmp_path / name / "notes.txt").touch()
    assert main(["report", name, "--workspace", str(workspace)]) == 2, "it may be meant as a capture"


def test_a_scene_that_was_trained_on_another_device_is_exported_and_rendered_on_this_machine(ran, tmp_path, monkeypatch, capsys):
    capture, workspace = ran
    copy = shutil.copytree(workspace, tmp_path / "ws")
    file = scene(copy) / "runs.json"
    file.write_text(file.read_text().replace('"cpu"', '"cuda"'))
    monkeypatch.setattr("e4dgs.workflows.machine.devices.why_not_cuda", lambda: "the NVIDIA driver finds no device")
    for words in (["render", "--frames", "1", "--size", "16"], ["export", "ply", "--times", "1"]):
        assert main([*words, str(capture), "--workspace", str(copy), "--out", str(tmp_path / words[0])]) == 0, capsys.readouterr().err
    words = ["render", str(capture), "--workspace", str(copy), "--out", str(tmp_path / "asked"), "--device", "cuda"]
    assert main(words) == 2 and "--device cuda" in capsys.readouterr().err, "a device that is asked for is not exchanged"


def test_report_why_show_and_pin_know_it_too(ran, capsys):
    capture, workspace = ran
    place = ["--workspace", str(workspace)]
    assert main(["report", str(capture), *place]) == 0
    assert "report.html" in capsys.readouterr().out
    assert main(["why", "coarse", str(capture), *place]) == 0
    assert "would be reused: nothing changed" in capsys.readouterr().out
    for words in ([str(capture), "coarse"], [str(scene(workspace)), "coarse"], [scene(workspace).name, "coarse"]):
        assert main(["show", *words, *place]) == 0, capsys.readouterr().err
        assert capsys.readouterr().out.startswith("coarse/")
    assert main(["pin", str(capture), *place]) == 0
    assert main(["unpin", scene(workspace).name, *place]) == 0


def test_a_wrong_option_is_answered_with_the_run_that_exists(ran, tmp_path, capsys):
    capture, workspace = ran
    words = [str(capture), "--workspace", str(workspace), "--preset", "fast", "--out", str(tmp_path / "x")]
    assert main(["render", *words]) == 2
    said = capsys.readouterr().err
    assert "The last run" in said and "--set coarse.iterations=5" in said and "none to take that run" in said


def test_options_that_are_given_still_choose(ran, tmp_path, capsys):
    capture, workspace = ran
    place = ["--workspace", str(workspace)]
    assert main(["run", "frames", str(capture), *place, "--set", "frames.max_size=16"]) == 0  # the last run now, but without a model
    assert main(["render", str(capture), *place, *QUICK, "--frames", "1", "--size", "16", "--out", str(tmp_path / "a")]) == 0
    assert main(["render", str(capture), *place, "--frames", "1", "--size", "16", "--out", str(tmp_path / "b")]) == 0
    assert (tmp_path / "a" / "0000.png").read_bytes() == (tmp_path / "b" / "0000.png").read_bytes()
    capsys.readouterr()
    assert main(["why", "frames", str(capture), *place]) == 0
    assert "frames.max_size=16" in capsys.readouterr().err


def test_the_results_of_the_last_run_are_found_after_an_edit_of_the_code(ran, tmp_path, monkeypatch):
    capture, workspace = ran
    from e4dgs.pipeline import plan

    key_of = plan.key_of
    monkeypatch.setattr(plan, "key_of", lambda parts: key_of({**parts, "more": "of the code"}))
    words = [str(capture), "--workspace", str(workspace), "--frames", "1", "--size", "16"]
    assert main(["render", *words, "--out", str(tmp_path / "out")]) == 0
    page, numbers = scene(workspace) / "report.html", scene(workspace) / "metrics.json"
    before = json.loads(numbers.read_text())
    page.unlink()
    assert main(["report", str(capture), "--workspace", str(workspace)]) == 0
    after = json.loads(numbers.read_text())
    assert page.is_file() and all(after[name] == before[name] for name in ("splits", "train_seconds")), "of the same results"
    assert main(["report", str(capture), "--workspace", str(workspace), *QUICK]) == 2
    assert main(["render", *words, *QUICK, "--out", str(tmp_path / "other")]) == 2  # these options ask for results of this code


def test_an_empty_workspace_and_an_unknown_scene_are_errors(tmp_path, capsys):
    for workspace in (tmp_path, tmp_path / "nosuch"):
        for command in (["view", "--no-browser"], ["render", "--out", str(tmp_path / "x.mp4")], ["export", "ply"], ["report"]):
            assert main([*command, "--workspace", str(workspace)]) == 2, command
            assert "no run is known" in capsys.readouterr().err
    assert main(["status", "nosuch", "--workspace", str(tmp_path)]) == 2
    assert "there is no such batch" in capsys.readouterr().err
    assert not (tmp_path / "nosuch").exists()
    assert main(["view", "nothing", "--workspace", str(tmp_path), "--no-browser"]) == 2
    assert "no such file or folder, and no scene" in capsys.readouterr().err


def test_the_list_of_runs_is_bounded_and_survives_damage(tmp_path):
    rows = [{"target": "all", "began": float(k), "set": [f"coarse.seed={k}"], "unknown": 1} for k in range(KEPT + 5)]
    (tmp_path / "runs.json").write_text(json.dumps({"runs": [*rows, 5, {"target": "all"}, {"began": 1.0}]}))
    assert last_run(tmp_path) == Run("all", Choice(set=(f"coarse.seed={KEPT + 4}",)), began=float(KEPT + 4))
    (tmp_path / "runs.json").write_text("[]")
    assert runs_of(tmp_path) == [] and last_run(tmp_path, "coarse") is None


def test_a_command_for_a_capture_that_begins_like_an_option_can_be_typed(cli, capture, tmp_path):
    capture.rename(tmp_path / "-take")
    result = cli("export", "ply", "./-take")
    assert result.code == 2 and "make it with: e4dgs run " in result.err and result.err.endswith("./-take\n"), result.err
    assert words_of(Options(Path("-take"), Path("e4dgs-workspace")))[0] == "./-take"


def test_a_run_of_a_later_stage_includes_the_earlier_ones(tmp_path):
    rows = [{"target": "evaluate", "began": 1.0}, {"target": "flow", "began": 2.0}]
    (tmp_path / "runs.json").write_text(json.dumps({"runs": rows}))
    assert last_run(tmp_path, "coarse").target == "evaluate"
    assert last_run(tmp_path, "frames").target == "flow"


def test_a_run_that_was_interrupted_leaves_the_one_before_it(tmp_path):
    rows = [{"target": "all", "began": 1.0, "done": True, "set": ["a.b=1"]}, {"target": "all", "began": 2.0}]
    (tmp_path / "runs.json").write_text(json.dumps({"runs": rows}))
    assert last_run(tmp_path, "coarse").began == 1.0, "exports and renders show what is finished"
    assert last_run(tmp_path, "coarse", done=False).began == 2.0, "the viewer and why ask for the newest"


def test_a_wrong_name_is_answered_with_the_scenes_there_are(ran, capsys):
    _, workspace = ran
    assert main(["report", "nosuch", "--workspace", str(workspace)]) == 2
    assert f"no scene of {workspace} has that name; its scenes are {scene(workspace).name}" in capsys.readouterr().err


def test_a_scene_whose_capture_has_gone_says_so(tmp_path, capsys):
    place = tmp_path / "scenes" / "moved"
    place.mkdir(parents=True)
    (place / "capture.json").write_text(json.dumps({"path": str(tmp_path / "gone")}))
    assert main(["view", "moved", "--workspace", str(tmp_path), "--no-browser"]) == 2
    assert "the scene moved was made from" in capsys.readouterr().err
