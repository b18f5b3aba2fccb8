"""What a user types, what is printed and written, and the exit codes: 0 done, 1 a stage failed, 2 bad arguments or capture."""

import json
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from e4dgs.pipeline import Store, unused

SCENE = Path("e4dgs-workspace/scenes/my-scene")


def test_run_all_leaves_metrics_report_and_plan(cli, capture):
    result = cli("run", "all", capture)
    assert result.code == 0, result.err
    assert "images" in result.out and "5 frames 32x24" in result.out and "4 train, 1 test" in result.out
    assert "30.00" in result.out and f"report: {SCENE.resolve() / 'report.html'}" in result.out
    metrics = json.loads((SCENE / "metrics.json").read_text())
    assert metrics["scene"] == "my-scene" and metrics["splits"]["test"]["psnr"] == 30.0 and metrics["render_fps"] == 12.5
    assert metrics["train_seconds"] == 1234.0, "a continued training counts with its own log"
    assert {name: stage["state"] for name, stage in metrics["stages"].items()} == dict.fromkeys(("frames", "fine", "evaluate"), "ran")
    assert set(metrics["stages"]["fine"]) == {"state", "reason", "seconds", "peak_rss_mb"}
    assert "all steps done" in (SCENE / "report.html").read_text()
    plan = json.loads((SCENE / "plan.json").read_text())
    assert [row["state"] for row in plan["stages"]] == ["run"] * 3 and plan["settings"]["fine"]["iterations"] == 10


def test_a_second_run_reuses_everything(cli, capture):
    cli("run", "all", capture)
    made = json.loads((SCENE / "metrics.json").read_text())["stages"]["fine"]
    (SCENE / "report.html").write_text("as it was")
    result = cli("run", "all", capture)
    assert result.code == 0 and "done in" not in result.out
    metrics = json.loads((SCENE / "metrics.json").read_text())
    assert {stage["state"] for stage in metrics["stages"].values()} == {"cached"}
    assert metrics["stages"]["fine"]["seconds"] == made["seconds"] is not None, "what the run that made it took"
    assert (SCENE / "report.html").read_text() == "as it was"
    (SCENE / "report.html").unlink()
    cli("run", "all", capture)
    assert (SCENE / "report.html").is_file()


def test_a_changed_setting_runs_what_depends_on_it(cli, capture):
    cli("run", "all", capture)
    plan = json.loads(cli("plan", capture, "--set", "fine.iterations=5", "--json").out)
    assert [(row["stage"], row["state"]) for row in plan["stages"]] == [("frames", "cached"), ("fine", "run"), ("evaluate", "run")]
    assert plan["stages"][1]["reason"] == "settings.iterations: 10 -> 5"
    assert "fine would run: settings.iterations: 10 -> 5" in cli("why", "fine", capture, "--set", "fine.iterations=5").out
    cli("run", "all", capture, "--set", "fine.iterations=5")
    metrics = json.loads((SCENE / "metrics.json").read_text())
    assert [stage["state"] for stage in metrics["stages"].values()] == ["cached", "ran", "ran"]
    assert metrics["splits"]["test"]["psnr"] == 25.0


def test_a_skipped_stage_is_recorded_with_its_reason(cli, capture):
    result = cli("run", "all", capture, "--set", "fine.iterations=0")
    assert result.code == 0 and "skip" in result.out
    stage = json.loads((SCENE / "metrics.json").read_text())["stages"]["fine"]
    assert stage == {"state": "skipped", "reason": "fine.iterations is 0", "seconds": 0.0, "peak_rss_mb": 0.0}


def test_run_one_stage_stops_there_and_force_reruns_it(cli, capture):
    assert cli("run", "fine", capture).code == 0
    assert not (SCENE / "metrics.json").exists()
    assert "fine: done" not in cli("run", "fine", capture).out
    forced = cli("run", "fine", capture, "--force")
    assert "fine: forced" in forced.out and "frames: done" not in forced.out


def test_plan_and_why_write_nothing(cli, capture):
    assert cli("plan", capture).code == 0
    assert "never run for this scene" in cli("why", "fine", capture).out
    assert not Path("e4dgs-workspace").exists()


def test_what_is_missing_of_a_capture_is_said_in_every_plan(cli, nerfstudio_capture, tmp_path):
    root = shutil.copytree(nerfstudio_capture.root, tmp_path / "holes")
    image = json.loads((root / "transforms.json").read_text())["frames"][3]["file_path"]
    (root / image).unlink()
    note = (
        f"1 of 10 frames of transforms.json have no image and are left out; first transforms.json: frame 3: file_path: no image '{image}'"
    )
    for _ in range(2):  # the second time from the store
        assert note in cli("plan", root).out
        assert json.loads(cli("plan", root, "--json", "--set", "frames.fps=30").out)["notes"] == [note]
        assert cli("run", "frames", root).out.count(note) == 1  # not also by the stage, whose record has it
    assert "cached" in cli("plan", root).out


def test_static_and_format_are_settings_of_frames(cli, capture):
    facts = json.loads(cli("plan", capture, "--static", "--format", "images", "--json").out)
    assert facts["recognised"]["static"] is True
    assert facts["settings"]["frames"]["static"] is True and facts["settings"]["frames"]["format"] == "images"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--set", "fine.iterations=101"), "less than or equal to 100"),
        (("--set", "fine.iters=1"), "did you mean 'iterations'?"),
        (("--preset", "fastest"), "presets: default, fast, compact, best"),
        (("--device", "tpu"), "choose one of auto, cpu, cuda"),
        (("--device", "cuda"), "use --device cpu"),
        (("--name", "../up"), "use up to 100 letters"),
        (("--format", "vhs"), "'images'"),
        (("--frobnicate",), "--frobnicate"),
    ],
)
def test_bad_arguments_exit_with_2_and_say_what_is_valid(cli, capture, arguments, message, monkeypatch):
    monkeypatch.setattr("e4dgs.workflows.machine.devices.why_not_cuda", lambda: "no driver")
    result = cli("run", "all", capture, *arguments)
    assert result.code == 2 and message in result.err and "Traceback" not in result.err
    assert not Path("e4dgs-workspace").exists()


def test_an_unknown_stage_and_a_missing_argument_exit_with_2(cli, capture):
    result = cli("run", "fime", capture)
    assert result.code == 2 and "give one of: all, frames, fine, evaluate" in result.err
    assert cli("run", "all").code == 2
    assert cli("why", "fime", capture).code == 2


def test_a_bad_capture_exits_with_2_and_leaves_no_scene(cli, capture, tmp_path):
    empty = tmp_path / "nothing"
    empty.mkdir()
    result = cli("run", "all", empty)
    assert result.code == 2 and result.err.startswith("error: ") and "empty" in result.err
    broken = shutil.copytree(capture, tmp_path / "broken")
    result = cli("run", "all", broken)
    assert (result.code, result.err) == (2, "error: 000.png: cut short; copy it again\n")
    assert not Path("e4dgs-workspace/scenes").exists()
    assert list(Path("e4dgs-workspace/store").glob("frames/*")) == [] == list(Path("e4dgs-workspace/store/tmp").iterdir())


def test_a_failing_stage_exits_with_1_in_one_line(cli, capture):
    result = cli("run", "all", capture, "--set", "fine.iterations=13")
    assert (result.code, result.err) == (1, "error: fine: 13 steps bring bad luck; choose another number\n")
    result = cli("run", "all", capture, "--set", "fine.iterations=14")
    assert (result.code, result.err) == (1, "error: fine failed: MemoryError: out of memory\n")
    assert "Traceback" in cli("run", "all", capture, "--set", "fine.iterations=14", "--debug").err


def test_two_captures_of_one_name_get_two_scenes(cli, capture, tmp_path):
    cli("run", "all", capture)
    other = shutil.copytree(capture, tmp_path / "elsewhere" / "my scene")
    result = cli("run", "all", other)
    assert result.code == 0 and "another capture already has this name" in result.out
    scenes = sorted(path.name for path in SCENE.parent.iterdir())
    assert len(scenes) == 2 and scenes[1].startswith("my-scene-")
    assert "done in" not in cli("run", "all", other).out
    assert len(list(SCENE.parent.iterdir())) == 2
    result = cli("run", "all", other, "--name", "my-scene")
    assert result.code == 2 and f"this scene belongs to {capture}" in result.err


def test_verify_finds_damage_and_the_next_run_repairs_it(cli, capture):
    cli("run", "all", capture)
    assert cli("verify").out.startswith("3 of 3 results")
    path = next(Path("e4dgs-workspace/store/fine").glob("*/info.json"))
    path.write_bytes(path.read_bytes().replace(b"1234", b"4321"))
    result = cli("verify")
    assert result.code == 1 and "info.json" in result.out and "2 of 3 results" in result.out
    assert not path.parent.exists() and path.parent.name in result.out.split("moved to ")[1], "it is in quarantine"
    assert cli("verify").out.startswith("2 of 2 results")
    assert "fine: done" in cli("run", "all", capture).out
    assert cli("verify").out.startswith("3 of 3 results")


def test_a_run_names_what_is_damaged_and_makes_it_again(cli, capture):
    cli("run", "all", capture)
    path = next(Path("e4dgs-workspace/store/fine").glob("*/zarr.json"))
    path.write_bytes(path.read_bytes().replace(b'"steps": 10', b'"steps": 11'))
    result = cli("run", "all", capture)
    assert result.code == 0 and result.out.count("damaged: ") == 1
    line = next(line for line in result.out.splitlines() if "damaged: " in line)
    assert line.startswith("fine: damaged: ") and f"fine/{path.parent.name}/zarr.json" in line
    assert json.loads((SCENE / "metrics.json").read_text())["splits"]["test"]["psnr"] == 30.0


def test_gc_removes_what_no_scene_used_last(cli, capture):
    cli("run", "all", capture)
    cli("run", "all", capture, "--set", "fine.iterations=5")
    assert "would remove fine/" in cli("gc", "--dry-run").out
    assert len(list(Path("e4dgs-workspace/store/fine").iterdir())) == 2
    result = cli("gc")
    assert result.code == 0 and "2 results" in result.out
    assert "done in" not in cli("run", "all", capture, "--set", "fine.iterations=5").out
    assert cli("gc").out.startswith("0 results")


def test_gc_and_list_count_the_same_bytes(cli, capture):
    cli("run", "all", capture)
    listed = json.loads(cli("store", "list", "--json").out)
    assert sum(row["bytes"] for row in listed) == unused(Store(Path("e4dgs-workspace/store")), tuple)[1] > 0


def test_one_is_no_plural(cli, capture):
    assert "5 frames 32x24, 1 camera, 5 times; " in cli("plan", capture).out


def test_gc_has_limits_and_says_what_is_left(cli, capture):
    cli("run", "all", capture)
    cli("run", "all", capture, "--set", "fine.iterations=5")
    assert cli("gc", "--older-than", "1d").out.startswith("0 results")
    assert cli("gc", "--keep-bytes", "1G").out.startswith("0 results")
    result = cli("gc", "--keep-bytes", "0", "--dry-run")
    assert "2 results" in result.out and "remove a folder under scenes/" in result.out
    assert cli("gc", "--keep-bytes", "0").out.count("removed ") == 2
    assert "done in" not in cli("run", "all", capture, "--set", "fine.iterations=5").out
    for words in (("--keep-bytes", "lots"), ("--older-than", "30"), ("--older-than", "-1d")):
        result = cli("gc", *words)
        assert result.code == 2 and words[0] in result.err


def test_a_pinned_scene_keeps_what_it_used_whatever_is_run_later(cli, capture):
    cli("run", "all", capture)
    assert cli("pin", "my-scene").out == "my-scene: 3 results are pinned\n"
    cli("run", "all", capture, "--set", "fine.iterations=5")
    assert cli("gc").out.startswith("0 results")
    assert [line.split()[-1] for line in cli("list", "fine").out.splitlines() if "my-scene" in line].count("my-scene") == 2
    assert "done in" not in cli("run", "all", capture).out
    cli("run", "all", capture, "--set", "fine.iterations=5")
    assert cli("unpin", "my-scene").code == 0
    assert cli("gc").out.count("removed ") == 2
    for words in (("unpin", "my-scene"), ("pin", "nobody"), ("unpin", "../up")):
        result = cli(*words)
        assert result.code == 2 and words[1] in result.err


def test_gc_spares_what_a_viewer_has_open(cli, capture):
    from e4dgs.pipeline import Artifact

    cli("run", "all", capture)
    held = Artifact(next(Path("e4dgs-workspace/store/fine").iterdir()))
    cli("run", "all", capture, "--set", "fine.iterations=5")
    out = cli("gc").out
    assert f"left fine/{held.path.name}: a process uses it" in out and "1 result," in out and held.path.is_dir()


def test_doctor_reports_what_fails_without_failing_itself(cli, monkeypatch):
    def broken() -> str:
        raise ImportError("no such library")

    monkeypatch.setattr("e4dgs.workflows.machine.doctor._render", broken)
    result = cli("doctor")
    assert result.code == 1
    assert "FAIL CPU kernels: ImportError: no such library" in result.out
    assert "ok   zarr writes and reads: with checksums" in result.out and "CUDA: " in result.out


def test_doctor_fails_for_what_is_needed_alone(cli, monkeypatch):
    asked = ["numpy>=1.26", 'no-such-reader>=2; platform_system == "Linux" and extra == "usd"', 'no-such-tool; extra == "dev"']
    monkeypatch.setattr("importlib.metadata.requires", lambda name: asked)
    result = cli("doctor")
    assert result.code == 0 and "ok   numpy: " in result.out
    assert "     no-such-reader: optional: pip install 'e4dgs[usd]'" in result.out and "no-such-tool" not in result.out
    asked.append("no-such-library>=1")
    result = cli("doctor")
    assert result.code == 1 and "FAIL no-such-library: not installed" in result.out


def test_doctor_says_what_the_cuda_kernels_need(cli, monkeypatch):
    monkeypatch.setattr("e4dgs.workflows.machine.doctor.why_not_cuda", lambda: None)
    monkeypatch.setattr("e4dgs.workflows.machine.doctor.why_not_trusted", lambda: "a small render on the GPU went wrong: it is green")
    monkeypatch.setattr("e4dgs.rasterizer.cuda.runtime.describe", lambda: [("CUDA driver", True, "supports CUDA 13.0")])
    result = cli("doctor")
    assert "CUDA: --device auto takes the CPU: a small render on the GPU went wrong: it is green" in result.out
    assert "ok   CUDA driver: supports CUDA 13.0" in result.out


def test_commands_that_a_run_tells_people_to_type_have_its_options(cli, capture):
    words = f"'{capture}' --workspace 'my w' --name one --static"
    chosen = ("--workspace", "my w", "--name", "one", "--static")
    ran = cli("run", "all", capture, *chosen, "--set", "fine.iterations=15")
    assert ran.code == 0 and f"all steps done; e4dgs export web {words} --set fine.iterations=15 writes a page" in ran.out
    scene = Path("my w/scenes/one")
    reason = json.loads((scene / "metrics.json").read_text())["splits"]["test"]["lpips_reason"]
    assert reason == f"no weights; then: e4dgs run evaluate {words} --set fine.iterations=15 --force"
    assert cli(*shlex.split(reason.partition("e4dgs ")[2])).out.count("done in") == 1, "evaluate alone, of the same run"
    assert "CAPTURE" not in (scene / "report.html").read_text()
    failed = cli("run", "all", capture, *chosen, "--set", "fine.iterations=16")
    assert failed.code == 1 and f"with `e4dgs run flow {words} --set fine.iterations=16 --force`" in failed.err
    assert "or see e4dgs store list --workspace 'my w'\n" in failed.err
    unknown = cli("store", "show", "nothing", "--workspace", "my w")
    assert "e4dgs store list --workspace" in unknown.err


def test_report_is_drawn_again_from_the_store_alone(cli, capture):
    result = cli("report", capture)
    assert result.code == 2 and "e4dgs run evaluate" in result.err
    cli("run", "all", capture)
    page = Path("e4dgs-workspace/scenes/my-scene/report.html")
    page.write_text("spoiled")
    result = cli("report", capture)
    assert result.code == 0 and result.out.splitlines()[-1].endswith(str(page))
    assert page.read_text().startswith("<html>my-scene") and "cached" in page.read_text()


def test_the_version_is_said(cli):
    import e4dgs

    assert cli("--version").out == f"e4dgs {e4dgs.__version__}\n"
    assert "--install-completion" in cli("--help").out


@pytest.mark.parametrize(
    ("line", "offered", "not_offered"),
    [("e4dgs pl", {"plan"}, {"run"}), ("e4dgs export m", {"mesh"}, {"ply"}), ("e4dgs run all x --pre", {"--preset"}, {"--set"})],
)
def test_bash_completes_commands_and_options(tmp_path, line, offered, not_offered):
    """A real bash sources the script that `--show-completion` prints, and asks its function."""
    program = tmp_path / "e4dgs"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m e4dgs.workflows.cli "$@"\n')
    program.chmod(0o755)
    script = (
        'source <("$1" --show-completion bash)\n'
        "IFS=' ' read -ra COMP_WORDS <<< \"$2\"; COMP_CWORD=$((${#COMP_WORDS[@]} - 1))\n"
        'function=$(complete -p e4dgs | sed -E "s/.*-F ([^ ]+).*/\\1/")\n'
        '"$function" "$1"; printf "%s\\n" "${COMPREPLY[@]}"\n'
    )
    command = ["bash", "--norc", "-c", script, "bash", str(program), line]
    done = subprocess.run(command, env={**os.environ, "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}, capture_output=True, text=True)
    found = set(done.stdout.split())
    assert offered <= found and not not_offered & found, done.stdout + done.stderr


def test_two_captures_in_one_command_are_told_what_to_do(cli, capture, tmp_path):
    for name in ("a.mp4", "b.mp4"):
        (tmp_path / name).write_bytes(b"1")
    result = cli("plan", tmp_path / "a.mp4", tmp_path / "b.mp4")
    assert result.code == 2 and "put videos of one event into a folder and pass it, or use e4dgs batch" in " ".join(result.err.split())
    assert "e4dgs batch" not in cli("plan", capture, "nothing-like-a-file").err
