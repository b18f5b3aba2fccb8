"""`e4dgs batch` and `status`: what is run, what is shown, and what becomes of scenes whose stages fail, hang or crash."""

import csv
import json
import os
import shlex
import shutil
import subprocess
import sys
import time
from html import unescape
from html.parser import HTMLParser

import pyarrow.parquet
import pytest
from e4dgs.pipeline import SettingsError
from e4dgs.workflows.batch.ledger import Ledger, SceneState
from e4dgs.workflows.batch.listing import Entry, entries_of
from e4dgs.workflows.batch.sites.cluster import read_cluster
from e4dgs.workflows.batch.sites.pools import Cluster
from e4dgs.workflows.batch.sites.slurm import emit
from e4dgs.workflows.batch.summary import COLUMNS, spread, worst_first, write_summary
from e4dgs.workflows.cli import main

QUICK = {"coarse.iterations": "20", "hulls.budget": "0", "fine.iterations": "0", "evaluate.movie_frames": "0"}
SET = [word for key, value in QUICK.items() for word in ("--set", f"{key}={value}")]
COMMON = Entry("", "")


def read(batch) -> list[dict[str, str]]:
    with open(batch / "results.csv", newline="") as file:
        return list(csv.DictReader(file))


def names(entries) -> list[str]:
    return [entry.name for entry in entries]


# -- the list of scenes


def test_paths_and_patterns_are_named_by_their_files(tmp_path):
    for name in ("b.mp4", "a.mp4"):
        (tmp_path / name).touch()
    (tmp_path / "scene 3.1").mkdir()
    entries = entries_of([str(tmp_path / "*.mp4"), str(tmp_path / "scene 3.1")], COMMON)
    assert names(entries) == ["a", "b", "scene-3.1"] and entries[0].capture == str(tmp_path / "a.mp4")
    with pytest.raises(SettingsError, match="no file or folder"):
        entries_of([str(tmp_path / "*.mov")], COMMON)


def test_captures_of_one_name_get_that_of_their_folder(tmp_path):
    for name in ("left", "right"):
        (tmp_path / name / "images").mkdir(parents=True)
    assert names(entries_of([str(tmp_path / "*" / "images")], COMMON)) == ["left-images", "right-images"]
    with pytest.raises(SettingsError, match="two scenes"):
        entries_of([str(tmp_path / "left")] * 2, COMMON)


def test_a_list_has_settings_for_all_and_for_one_and_a_sweep(tmp_path):
    (tmp_path / "one").mkdir()
    (tmp_path / "two").mkdir()
    file = tmp_path / "scenes.yaml"
    file.write_text(
        "preset: fast\nsettings: {coarse.iterations: 50, frames.max_size: 64}\n"
        "scenes:\n  - one\n  - {capture: two, name: second, settings: {coarse.iterations: 70, evaluate.splits: [val, test]},\n"
        "     static: true}\n"
        "sweep:\n  train.seed: [0, 1]\n  train.alpha_weight: [0.5]\n"
    )
    entries = entries_of([str(file)], Entry("", "", (("fine.iterations", "0"),)))
    assert names(entries) == [f"{name}-seed-{seed}-alpha_weight-0.5" for name in ("one", "second") for seed in (0, 1)]
    first, _, third, _ = entries
    assert dict(first.settings) == {
        "fine.iterations": "0",
        "coarse.iterations": "50",
        "frames.max_size": "64",
        "train.seed": "0",
        "train.alpha_weight": "0.5",
    }
    assert dict(third.settings)["coarse.iterations"] == "70" and dict(third.settings)["evaluate.splits"] == "val,test"
    assert (first.preset, first.static, third.static) == ("fast", False, True)
    assert first.group == entries[1].group == "one train.alpha_weight=0.5", "seeds alone make no other group"
    assert Entry.from_json(json.loads(json.dumps(third.as_json()))) == third


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("3", "expected a list of captures"),
        ("scenes: [3]", "scene 1: expected a path"),
        ("scenes: [a]\npresets: fast", "unknown field presets"),
        ("scenes: [{capture: a, nam: b}]", "scene 1: unknown field nam"),
        ("scenes: [a]\nsweep: {train.seed: 3}", "list of values"),
        ("scenes: [{capture: a, settings: 3}]", "settings: expected"),
        ("scenes: [", "not a list of scenes in YAML"),
    ],
)
def test_a_bad_list_is_one_message_that_names_the_place(tmp_path, text, said):
    file = tmp_path / "list.yml"
    file.write_text(text)
    with pytest.raises(SettingsError, match=said):
        entries_of([str(file)], COMMON)


# -- whole batches


@pytest.fixture(scope="module")
def finished(dnerf_capture, tmp_path_factory):
    """Two scenes, one of which is no capture."""
    folder = tmp_path_factory.mktemp("batch")
    (folder / "empty").mkdir()
    words = ["batch", str(dnerf_capture.root), str(folder / "empty"), "--name", "pair", "--workspace", str(folder / "work"), *SET]
    return main(words), folder, words


def test_what_can_be_run_is_run_and_the_rest_is_told(finished, capsys):
    code, folder, _ = finished
    assert code == 1
    batch = folder / "work" / "batches" / "pair"
    rows = read(batch)
    assert list(rows[0]) == list(COLUMNS) and [row["state"] for row in rows] == ["done", "failed"]
    scene = rows[0]["scene"]
    metrics = json.loads((folder / "work" / "scenes" / scene / "metrics.json").read_text())
    assert float(rows[0]["psnr"]) == metrics["splits"]["test"]["psnr"] and rows[0]["split"] == "test"
    assert "empty" in rows[1]["message"] and rows[1]["psnr"] == ""
    table = pyarrow.parquet.read_table(batch / "results.parquet").to_pylist()
    assert table[0]["psnr"] == metrics["splits"]["test"]["psnr"] and table[1]["psnr"] is None
    assert main(["status", "--workspace", str(folder / "work")]) == 0
    assert "pair: 1 failed, 1 done" in capsys.readouterr().out


def test_a_worker_makes_no_other_scene_of_its_batch(tmp_path, monkeypatch):
    """It asks for its own before each part: making all of them each time is quadratic."""
    entries = [Entry(name, f"/captures/{name}") for name in "abc"]
    ledger, made = Ledger.create(tmp_path, "b", entries), []
    from_json = Entry.from_json
    monkeypatch.setattr(Entry, "from_json", lambda row: made.append(row["name"]) or from_json(row))
    assert ledger.entry("b") == entries[1] and ledger.entry("d") is None and made == ["b"]


def test_two_heads_can_write_the_results_at_the_same_time(tmp_path, monkeypatch):
    """One writes its own while the other is in the middle of its table."""
    ledger = Ledger.create(tmp_path, "b", [Entry("a", "/captures/a")])
    write_table = pyarrow.parquet.write_table

    def meanwhile(table, where):
        monkeypatch.setattr(pyarrow.parquet, "write_table", write_table)
        write_table(table, where)
        write_summary(ledger)

    monkeypatch.setattr(pyarrow.parquet, "write_table", meanwhile)
    write_summary(ledger)
    assert len(pyarrow.parquet.read_table(ledger.folder / "results.parquet")) == 1
    assert not list(ledger.folder.glob(".*"))


def test_the_page_links_to_reports_and_players_and_shows_the_worst_first(finished):
    class Links(HTMLParser):
        def __init__(self):
            super().__init__()
            self.found = []

        def handle_starttag(self, tag, attrs):
            if tag == "a":
                self.found.append(dict(attrs)["href"])

    batch = finished[1] / "work" / "batches" / "pair"
    page = (batch / "results.html").read_text()
    parser = Links()
    parser.feed(page)
    assert [os.path.basename(link) for link in parser.found] == ["report.html", "player.html"]
    assert all((batch / link).is_file() for link in parser.found)
    assert [read(batch)[0][name] for name in ("report", "player")] == parser.found
    assert page.index(">empty<") < page.index("report.html")
    command = unescape(page.split("<pre>")[1].split("</pre>")[0])
    assert sorted(shlex.split(command)) == sorted(["e4dgs", *finished[2]])
    rows = [{"state": s, "psnr": p} for s, p in (("done", 30.0), ("waiting", None), ("done", 20.0), ("failed", None))]
    assert [row["psnr"] for row in worst_first(rows)] == [None, 20.0, 30.0, None]


def test_the_same_batch_again_runs_nothing_that_is_done(finished):
    _, folder, words = finished
    logs = {file: file.read_bytes() for file in (folder / "work" / "batches" / "pair" / "logs").iterdir()}
    assert main(words) == 1
    assert {file: file.read_bytes() for file in logs} == logs


def test_a_scene_whose_results_are_gone_is_run_again(finished):
    """ "done" in a file is believed only as long as the store says so, too."""
    _, folder, words = finished
    log = Ledger(folder / "work", "pair").log(read(folder / "work" / "batches" / "pair")[0]["scene"])
    before = log.read_text()
    shutil.rmtree(folder / "work" / "store" / "evaluate")
    assert main(words) == 1
    assert log.read_text().startswith(before) and log.read_text() != before
    assert read(folder / "work" / "batches" / "pair")[0]["state"] == "done"


def test_a_scene_with_other_settings_is_run_again(finished, dnerf_capture):
    _, folder, _ = finished
    ledger = Ledger(folder / "work", "pair")
    before = ledger.entries()
    changed = [Entry(before[0].name, before[0].capture, (("coarse.iterations", "30"),))]
    again = Ledger.create(folder / "work", "other", before[:1])
    again.write(before[0].name, SceneState("done"))
    assert Ledger.create(folder / "work", "other", before[:1]).progress(before[0].name).state == "done"
    assert Ledger.create(folder / "work", "other", changed).progress(before[0].name).state == "waiting"


def test_seeds_are_summed_up():
    rows = [{"group": "a", "psnr": 20.0}, {"group": "a", "psnr": 22.0}, {"group": "b", "psnr": 30.0}, {"group": "a", "psnr": None}]
    assert spread(rows) == [{"group": "a", "runs": 2, "mean": 21.0, "deviation": pytest.approx(2**0.5)}]


def test_a_stage_that_hangs_is_ended_and_tried_again(dnerf_capture, tmp_path):
    words = ["batch", str(dnerf_capture.root), "--workspace", str(tmp_path), "--stage-timeout", "0.3", "--retries", "1", *SET]
    assert main(words) == 1
    (row,) = read(tmp_path / "batches" / "batch")
    assert row["attempts"] == "2" and "--stage-timeout" in row["message"]


def test_no_process_can_be_started(dnerf_capture, tmp_path, monkeypatch):
    broken = tmp_path / "python"
    broken.write_text("#!/bin/sh\necho no such library >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setattr("e4dgs.workflows.batch.forks.sys.executable", str(broken))
    monkeypatch.setenv("E4DGS_TEST", "no server of another test serves this one")
    assert main(["batch", str(dnerf_capture.root), "--workspace", str(tmp_path / "work"), "--retries", "0", *SET]) == 1
    (row,) = read(tmp_path / "work" / "batches" / "batch")
    log = Ledger(tmp_path / "work", "batch").log(dnerf_capture.root.name)
    assert str(log) in row["message"] and row["stage"] == "frames" and row["attempts"] == "1"
    assert "no such library" in log.read_text()


def test_a_batch_that_is_interrupted_ends_its_stages_and_goes_on_later(dnerf_capture, tmp_path):
    capture, workspace = str(dnerf_capture.root), str(tmp_path / "work")
    words = ["batch", capture, "--workspace", workspace, "--set", "coarse.iterations=100000", "--set", "coarse.patience=100000"]
    command = [sys.executable, "-m", "e4dgs.workflows.cli", *words]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    ledger = Ledger(tmp_path / "work", "batch")
    until = time.monotonic() + 60
    while not (ledger.exists() and ledger.progress(dnerf_capture.root.name).stage == "coarse"):
        assert time.monotonic() < until
        time.sleep(0.2)
    process.terminate()  # as Ctrl-C does, which a shell's background jobs do not hear
    assert "interrupted; finished results are kept" in process.communicate(timeout=40)[1]
    assert process.returncode == 130
    assert ledger.progress(dnerf_capture.root.name).state == "waiting"
    running = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True).stdout
    assert workspace not in running, "no stage is left behind"


# -- clusters


def test_parsl_runs_a_batch_on_this_machine(dnerf_capture, tmp_path):
    pytest.importorskip("parsl")
    file = tmp_path / "cluster.yaml"
    file.write_text("retries: 1\ncpu: {provider: local, workers: 1, cores: 1}\ngpu: {provider: local, workers: 1}\n")
    words = ["batch", str(dnerf_capture.root), "--workspace", str(tmp_path / "work"), "--executor", str(file), *SET, "--device", "cpu"]
    done = subprocess.run([sys.executable, "-m", "e4dgs.workflows.cli", *words], capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stderr
    (row,) = read(tmp_path / "work" / "batches" / "batch")
    assert row["state"] == "done" and float(row["psnr"]) > 5


def test_the_cluster_files_that_come_along_are_read():
    from pathlib import Path

    import e4dgs.workflows

    files = sorted((Path(e4dgs.workflows.__file__).parent / "clusters").glob("*.yaml"))
    assert [file.stem for file in files] == ["kubernetes", "local", "slurm"]
    for file in files:
        assert read_cluster(file).cpu.provider == file.stem


@pytest.mark.parametrize(("text", "said"), [("cpu: {worker: 3}", "cpu.worker"), ("retries: many", "retries"), ("[", "YAML")])
def test_a_bad_cluster_file_names_the_field(tmp_path, text, said):
    file = tmp_path / "c.yaml"
    file.write_text(text)
    with pytest.raises(SettingsError, match=said):
        read_cluster(file)


def test_job_scripts_for_slurm_are_shell_and_do_the_work(dnerf_capture, tmp_path):
    """Run as Slurm would run the first task of each array."""
    work = tmp_path / "a work space"
    words = ["batch", str(dnerf_capture.root), "--workspace", str(work), "--emit", "slurm", "--device", "cpu", *SET]
    assert main(words) == 0
    folder = work / "batches" / "batch" / "slurm"
    for file in (*folder.glob("*.sbatch"), folder / "submit.sh"):
        subprocess.run(["bash", "-n", str(file)], check=True)
        lines = file.read_text().splitlines()
        first = next(k for k, line in enumerate(lines) if line and not line.startswith("#"))
        assert not [line for line in lines[first:] if line.startswith("#SBATCH")], "Slurm reads no options after the first command"
    for part in ("before", "train", "after"):
        subprocess.run(["bash", str(folder / f"{part}.sbatch")], check=True, env=dict(os.environ, SLURM_ARRAY_TASK_ID="0"))
    assert Ledger(work, "batch").progress(dnerf_capture.root.name).state == "done"


def test_arrays_of_slurm_have_at_most_a_thousand_tasks(tmp_path):
    ledger = Ledger.create(tmp_path, "many", [Entry(f"scene{k}", "/capture") for k in range(2003)])
    ledger.write("scene7", SceneState("done"))
    folder = emit(ledger, Cluster.model_validate({"cpu": {"provider": "slurm"}}))
    assert "scene7\n" not in (folder / "scenes.txt").read_text()
    fake = tmp_path / "bin" / "sbatch"
    fake.parent.mkdir()
    fake.write_text(f'#!/bin/sh\necho "$@" >> {tmp_path}/said\necho 17\n')
    fake.chmod(0o755)
    subprocess.run([str(folder / "submit.sh")], check=True, env=dict(os.environ, PATH=f"{fake.parent}:{os.environ['PATH']}"))
    said = (tmp_path / "said").read_text().splitlines()
    arrays = [[word.partition("=")[2] for word in line.split() if word.startswith(("--array", "--export"))] for line in said[::3]]
    assert arrays[:3] == [[f"0-{last}", f"ALL,E4DGS_FIRST={first}"] for first, last in ((0, 999), (1000, 999), (2000, 1))]
    assert said[-1] == "--dependency=afterany:17:17:17 results.sbatch"


# -- what is refused


@pytest.mark.parametrize("words", [["batch", "x", "--name", "../up"], ["batch", "x", "--set", "nonsense"], ["status"]])
def test_bad_words_are_one_message(tmp_path, words, capsys):
    assert main([*words, "--workspace", str(tmp_path / "w")]) == 2
    assert capsys.readouterr().err.startswith("error: ")
    assert not (tmp_path / "w").exists()
