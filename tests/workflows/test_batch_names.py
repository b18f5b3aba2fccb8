"""Names in a batch: of captures with brackets, of scenes that the workspace has already, and how both are printed."""

import csv
import re
from pathlib import Path

from e4dgs.workflows.batch.ledger import Ledger, SceneState
from e4dgs.workflows.batch.listing import Entry, entries_of
from e4dgs.workflows.batch.work import run_part
from e4dgs.workflows.cli import main
from e4dgs.workflows.scenes import check_name, find_scene

COMMON = Entry("", "")


def test_a_file_with_brackets_in_its_name_is_no_pattern(tmp_path):
    for name in ("clip [HD]", "clip H", "clip D", "clip E"):
        (tmp_path / name).mkdir()
    assert [entry.capture for entry in entries_of([str(tmp_path / "clip [HD]")], COMMON)] == [str(tmp_path / "clip [HD]")]
    (tmp_path / "list.yaml").write_text("- 'clip [HD]'\n- 'clip [DE]'\n")
    assert [entry.name for entry in entries_of([str(tmp_path / "list.yaml")], COMMON)] == ["clip-HD", "clip-D", "clip-E"]


def test_names_of_all_scripts_stay_apart(tmp_path):
    for name in ("日本.mp4", "東京.mkv", "☀.mp4", "☂.mp4", "a/x/clip.mp4", "b/x/clip.mp4"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    two = [str(tmp_path / name) for name in ("日本.mp4", "東京.mkv")]
    assert [entry.name for entry in entries_of(two, COMMON)] == ["日本", "東京"]
    names = [entry.name for entry in entries_of([str(tmp_path / "*.mp4"), str(tmp_path / "*" / "x" / "*.mp4")], COMMON)]
    assert len(set(names)) == 5 and "日本" in names
    assert all(re.fullmatch(r"(test.*-capture|x-clip)-[0-9a-f]{6}|日本", name) for name in names)


def test_long_names_are_names_of_scenes_and_of_files(tmp_path):
    for folder in ("長" * 70, "短" * 70):
        (tmp_path / folder / ("語" * 70)).mkdir(parents=True)
    (tmp_path / "list.yaml").write_text(
        "scenes: ['*/*']\nsweep: {evaluate.lpips_weights: [モデル, 重み], train.seed: [0, 1], frames.max_size: [640, 320]}\n",
        encoding="utf-8",
    )
    names = [entry.name for entry in entries_of([str(tmp_path / "list.yaml")], COMMON)]
    assert len(set(names)) == 16
    ledger = Ledger(tmp_path / "work", "夜")
    for name in names:
        check_name(name, "batch")
        ledger.write(name, SceneState("failed", "frames", "no"))
        assert ledger.progress(name).state == "failed"


def test_a_batch_with_names_of_any_script_is_shown_and_written_as_scripts(dnerf_capture, tmp_path, capsys):
    (tmp_path / "東京").symlink_to(dnerf_capture.root)
    work = str(tmp_path / "work")
    assert main(["batch", str(tmp_path / "東京"), "--name", "夜", "--workspace", work, "--emit", "slurm", "--device", "cpu"]) == 0
    folder = tmp_path / "work" / "batches" / "夜"
    assert (folder / "slurm" / "scenes.txt").read_text(encoding="utf-8") == "東京\n"
    assert " 夜 " in (folder / "slurm" / "before.sbatch").read_text(encoding="utf-8").replace("'", "")
    assert main(["status", "夜", "--workspace", work]) == 0
    assert "東京" in capsys.readouterr().out


def test_a_name_that_another_capture_has_is_told_with_the_line_that_names_the_scene(dnerf_capture, tmp_path):
    name = dnerf_capture.root.name
    find_scene(tmp_path / "work", Path("/other") / name, name, None).claim()
    assert main(["batch", str(dnerf_capture.root), "--workspace", str(tmp_path / "work")]) == 1
    with open(tmp_path / "work" / "batches" / "batch" / "results.csv", newline="") as file:
        (row,) = csv.DictReader(file)
    assert row["state"] == "failed" and f"belongs to /other/{name}" in row["message"] and "--name" not in row["message"]
    (line,) = re.findall(r"- \{.*\}", row["message"])
    (tmp_path / "list.yaml").write_text(line)
    (entry,) = entries_of([str(tmp_path / "list.yaml")], COMMON)
    assert entry.capture == str(dnerf_capture.root) and entry.name != name
    assert find_scene(tmp_path / "work", Path(entry.capture), name, entry.name).folder == tmp_path / "work" / "scenes" / entry.name


def test_names_with_brackets_are_printed_as_they_are(dnerf_capture, tmp_path, capsys):
    work = tmp_path / "d[" / "a]"  # together they look like the end of a tag
    assert main(["batch", str(dnerf_capture.root), "--workspace", str(work), "--emit", "slurm", "--device", "cpu"]) == 0
    assert f"submit with: {work}" in "".join(capsys.readouterr().out.splitlines())
    ledger = Ledger(work, "batch")
    ledger.write(dnerf_capture.root.name, SceneState("failed", "frames", r"a\[/b]: cannot be read [/c]"))
    assert main(["status", "--workspace", str(work)]) == 0
    assert r"a\[/b]: cannot be read [/c]" in " ".join(capsys.readouterr().out.split())


def test_two_batches_of_one_name_do_not_run_at_the_same_time(tmp_path, capsys):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    words = ["--workspace", str(tmp_path / "work"), "--emit", "slurm"]
    assert main(["batch", str(tmp_path / "a"), *words]) == 0
    ledger = Ledger(tmp_path / "work", "batch")
    with ledger.held(ledger.entries()):
        assert main(["batch", str(tmp_path / "b"), *words]) == 2
        said = "--name batch: a batch of this name with another list is running in another process; give this one another --name"
        assert said in capsys.readouterr().err
        assert main(["batch", str(tmp_path / "a"), *words]) == 0, "the same list is worked on together"
        assert main(["batch", str(tmp_path / "b"), *words, "--name", "other"]) == 0
    assert [entry.name for entry in ledger.entries()] == ["a"], "the running batch keeps its list"
    assert main(["batch", str(tmp_path / "a"), str(tmp_path / "b"), *words]) == 0
    assert "replaces" not in capsys.readouterr().out, "it is the same batch with another scene"
    assert main(["batch", str(tmp_path / "b"), *words]) == 0
    (tmp_path / "c").mkdir()
    assert main(["batch", str(tmp_path / "c"), *words]) == 0
    assert "--name batch: this replaces the earlier batch of 1 scene (b)" in capsys.readouterr().out
    assert run_part(str(tmp_path / "work"), "batch", "b", "before") is False, "a job of the earlier list has nothing to do"
