"""`--time` from the command line: a run decides its settings as it goes, they are kept, and every command finds its results."""

import json
import re
import shlex
from types import SimpleNamespace

import pytest
from e4dgs.pipeline import Outcome
from e4dgs.pipeline.files import read_json, write_json
from e4dgs.workflows.cli import main
from e4dgs.workflows.last_run import runs_of
from e4dgs.workflows.timing import ladder, resolve
from e4dgs.workflows.timing.known import FILE, Known
from e4dgs.workflows.timing.steps import rehearse
from e4dgs.workflows.timing.timed import Timed

TIME = "20s"
QUICK = ["--static", "--device", "cpu", "--set", "coarse.budget=120", "--set", "seeds.count=60", "--set", "evaluate.player=false"]


@pytest.fixture(scope="module")
def patched():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ladder, "LEAST_STEPS", 20)
        patch.setattr(ladder, "LEAST_EFFORT", 20 / 6000)
        patch.setattr(ladder, "LEAST_REFINEMENT", 10)
        patch.setattr(resolve, "LEAST_REFINEMENT", 10)
        patch.setattr(ladder, "most_effort", lambda: 0.05)
        patch.setattr(resolve, "most_effort", lambda: 0.05)
        yield patch


@pytest.fixture(scope="module")
def ran(patched, dnerf_capture, tmp_path_factory):
    """A capture that was run with a time, its workspace, and what the run expected of its stages."""
    workspace, expected = tmp_path_factory.mktemp("time") / "ws", {}
    published = Timed.published

    def look(self, seconds):
        expected.update(self._expected)
        published(self, seconds)

    patched.setattr(Timed, "published", look)
    assert main(["run", "all", str(dnerf_capture.root), "--time", TIME, "--workspace", str(workspace), *QUICK]) == 0
    return dnerf_capture.root, workspace, expected


def scene(workspace):
    (folder,) = (workspace / "scenes").iterdir()
    return folder


def states(workspace):
    return {name: stage["state"] for name, stage in read_json(scene(workspace) / "metrics.json")["stages"].items()}


def test_what_was_decided_is_in_the_settings_and_kept(ran):
    _, workspace, _ = ran
    (run,) = runs_of(scene(workspace))
    plan = read_json(scene(workspace) / "plan.json")
    decided = dict(text.split("=") for text in run.choice.resolved)
    assert run.choice.time == plan["time"] == TIME and run.done and list(run.choice.resolved) == plan["decided"]
    assert 20 <= int(decided["coarse.iterations"]) <= 300
    assert {"coarse.iterations", "fine.iterations", "hulls.share"} <= decided.keys()
    for name, value in decided.items():
        stage, key = name.split(".")
        assert plan["settings"][stage][key] == pytest.approx(float(value))


def test_training_takes_about_what_was_expected(ran):
    """By a factor that allows for a machine on which everything else is done at the same time."""
    _, workspace, expected = ran
    took = read_json(scene(workspace) / "metrics.json")["stages"]
    assert expected["coarse"] > 0
    assert 0.1 < took["coarse"]["seconds"] / expected["coarse"] < 10


def test_what_was_measured_is_known_in_the_workspace(ran):
    _, workspace, _ = ran
    (table,) = read_json(workspace / FILE).values()
    (kind,) = table["steps"]
    assert Known(workspace, "cpu").costs(kind)[-1].step(1.0, 100) > 0


def test_a_repeat_is_cached_and_measures_nothing(ran, monkeypatch, capsys):
    capture, workspace, _ = ran
    monkeypatch.setattr(rehearse, "rehearse", lambda *a, **k: pytest.fail("measured again"))
    before = runs_of(scene(workspace))[0].choice.resolved
    words = ["run", "all", str(capture), "--workspace", str(workspace), *QUICK]
    assert main([*words, "--time", "0m20s"]) == 0, capsys.readouterr().err
    assert set(states(workspace).values()) <= {"cached", "skipped"}
    assert runs_of(scene(workspace))[-1].choice.resolved == before


def test_a_stage_that_runs_again_keeps_them(ran, monkeypatch, capsys):
    capture, workspace, _ = ran
    monkeypatch.setattr(rehearse, "rehearse", lambda *a, **k: pytest.fail("measured again"))
    before = runs_of(scene(workspace))[0].choice.resolved
    words = ["run", "fine", str(capture), "--time", TIME, "--force", "--workspace", str(workspace), *QUICK]
    assert main(words) == 0, capsys.readouterr().err
    assert {run.target: run.choice.resolved for run in runs_of(scene(workspace))} == {"all": before, "fine": before}
    assert main(["run", "all", *words[2:5], *words[6:]]) == 0
    assert set(states(workspace).values()) <= {"cached", "skipped"}


def test_other_commands_find_its_results(ran, tmp_path, capsys):
    capture, workspace, _ = ran
    place = ["--workspace", str(workspace)]
    assert main(["why", "coarse", str(capture), *place]) == 0
    assert "would be reused: nothing changed" in capsys.readouterr().out
    assert main(["plan", str(capture), "--time", TIME, "--json", *place, *QUICK]) == 0
    assert {row["state"] for row in json.loads(capsys.readouterr().out)["stages"]} <= {"cached", "skip"}
    out = tmp_path / "out"
    assert main(["render", "--path", "turntable", "--frames", "2", "--size", "16", "--out", str(out), *place]) == 0
    assert len(list(out.iterdir())) == 2
    assert main(["report", str(capture), *place]) == 0


def test_the_settings_alone_make_the_same_result(ran, capsys):
    capture, workspace, _ = ran
    run = runs_of(scene(workspace))[0]
    assert main(["run", "all", str(capture), "--workspace", str(workspace), "--device", "cpu", *shlex.split(run.words)]) == 0
    assert set(states(workspace).values()) <= {"cached", "skipped"}


def test_a_plan_says_what_it_expects(patched, dnerf_capture, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(resolve, "most_effort", lambda: 3.0)
    words = [str(dnerf_capture.root), "--workspace", str(tmp_path), "--time", "10m", "--device", "cpu"]
    assert main(["plan", *words, "--json"]) == 0
    plan = json.loads(capsys.readouterr().out)
    seconds = {row["stage"]: row["estimate_seconds"] for row in plan["stages"] if row["state"] == "run"}
    assert seconds["coarse"] > 0 and 0.9 * 600 < sum(seconds.values()) < 600, "the whole time is used, by all stages together"
    assert main(["plan", *words]) == 0
    assert "of 10m" in capsys.readouterr().out
    assert not (tmp_path / "scenes").exists(), "a plan writes nothing"


def test_a_time_that_is_too_short_is_said_with_what_the_plan_expects(dnerf_capture, tmp_path, capsys):
    figures = []
    for more in ([], ["--preset", "fast", "--set", "coarse.iterations=100"], ["--set", "coarse.iterations=9000"]):
        words = [str(dnerf_capture.root), "--workspace", str(tmp_path), "--time", "2s", "--device", "cpu", *more]
        assert main(["plan", *words]) == 0
        said = capsys.readouterr().out
        (figure,) = re.findall("--time 2s is too short for this capture: the shortest sensible run takes about (.*), and", said)
        assert f"expected: about {figure} of 2s" in said, more
        figures.append(figure)
    assert len(set(figures)) == 3, "steps that the user chose count"


@pytest.mark.parametrize("text", ["soon", "10", "-3m", "0s"])
def test_a_bad_time_is_one_line_and_exit_code_2(dnerf_capture, tmp_path, capsys, text):
    assert main(["run", "all", str(dnerf_capture.root), f"--time={text}", "--workspace", str(tmp_path)]) == 2
    said = capsys.readouterr().err.strip()
    assert said.startswith(f"error: --time {text}: expected") and "\n" not in said


def test_other_facts_are_decided_anew(ran, patched, capsys):
    capture, workspace, _ = ran
    file = scene(workspace) / "runs.json"
    content = read_json(file)
    write_json(file, {"runs": [{**row, "facts": "other"} for row in content["runs"]]})
    assert main(["plan", str(capture), "--time", TIME, "--workspace", str(workspace), *QUICK]) == 0
    assert "decided again" in capsys.readouterr().out
    write_json(file, content)


def test_a_damaged_file_of_speeds_is_not_believed(tmp_path):
    for content in ([], {"x": 3}, {Known(tmp_path, "cpu").machine: {"ratios": {"flow": "fast"}, "steps": []}}):
        write_json(tmp_path / FILE, content)
        known = Known(tmp_path, "cpu")
        assert known.stage_ratio("flow") == 1.0 and known.costs("any") is None
        known.learn(30.0, 10.0, "flow")
        known.write()
        assert Known(tmp_path, "cpu").ratio("flow") == 3.0


def test_speeds_are_learned_step_by_step(tmp_path):
    known = Known(tmp_path, "cpu")
    known.learn(40.0, 10.0, "coarse", "kind")
    known.learn(10.0, 10.0, "coarse", "kind")
    assert known.ratio("coarse", "kind") == pytest.approx(2.0)
    known.learn(1.0, 0.1, "flow")
    assert known.stage_ratio("flow") == 1.0, "what takes a second says nothing about the machine"
    known.learn(9.0, 3.0, "poses")
    assert known.stage_ratio("flow") == 3.0, "the machine is as slow as elsewhere"


def outcome(seconds, reason="never run for this scene", state="ran", partly=False):
    return Outcome("flow", state, reason, seconds, partly=partly)


def test_any_whole_stage_teaches_the_speed(tmp_path):
    stage = SimpleNamespace(estimate=lambda facts, settings: 10.0)
    job = SimpleNamespace(graph={"flow": stage}, settings={"flow": None}, capture=SimpleNamespace(facts={}))
    known = Known(tmp_path, "cpu")
    for part in (
        outcome(30, "input frames changed; 3 of 9 pairs are new", partly=True),
        outcome(30, "x; continues from a checkpoint", partly=True),
        outcome(30, state="cached"),
    ):
        known.learn_stage(job, part)
    assert known.machine_ratio() == 1.0
    known.learn_stage(job, outcome(5.0, "settings.note: colours are new -> continues from a checkpoint"))
    assert known.machine_ratio() == 0.5, "words of a reason may be a person's"


def test_a_plan_without_a_time_follows_the_speed_that_runs_showed(dnerf_capture, tmp_path, capsys):
    def promised():
        assert main(["plan", str(dnerf_capture.root), "--workspace", str(tmp_path), "--device", "cpu", "--json"]) == 0
        return {row["stage"]: row["estimate_seconds"] for row in json.loads(capsys.readouterr().out)["stages"]}

    before = promised()
    write_json(tmp_path / FILE, {Known(tmp_path, "cpu").machine: {"ratios": {"coarse": 0.5, "seeds": 0.4, "evaluate": 3.0}}})
    assert promised() == {stage: None if seconds is None else pytest.approx(seconds / 2) for stage, seconds in before.items()}
