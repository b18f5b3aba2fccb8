"""benchmarks/publish.py: runs that are kept are not repeated, rows name the code that they are behind, tables show means and spreads."""

import argparse
import sys
from pathlib import Path

import pytest
from script_module import load_script

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
CODE = {"frames": "f" * 16, "coarse": "c" * 16, "evaluate": "e" * 16}


@pytest.fixture
def rows(tmp_path, monkeypatch):
    """quality_rows with one row, `sample`, whose results lie in a folder of their own."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    monkeypatch.setitem(sys.modules, "quality_rows", module := load_script(BENCHMARKS / "quality_rows.py"))
    monkeypatch.setattr(module, "ROWS_FOLDER", tmp_path / "rows")
    monkeypatch.setattr(module, "ROWS", {"sample": module.Row("cube", "the cube", "test")})
    monkeypatch.setattr(module, "code_now", lambda device: dict(CODE))
    for name in ("tables", "quality_tables"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return module


@pytest.fixture
def publish(rows, monkeypatch):
    """publish.py, whose runs take no time: `measured` lists their titles and seeds."""
    module = load_script(BENCHMARKS / "publish.py")
    module.measured = []

    def measure(row, name, seed, capture, workspace, more):
        module.measured.append((row.title, seed))
        return run(seed, seconds=module.takes)

    monkeypatch.setattr(module, "measure", measure)
    monkeypatch.setattr(module, "machine", lambda: {"processor": "P", "commit": "abc"})
    monkeypatch.setattr(module.psutil, "cpu_percent", lambda seconds: module.busy)
    module.busy, module.takes = 0.0, 60.0
    return module


def run(seed: int, seconds: float = 60.0, lpips: float | None = 0.1, **changed) -> dict:
    views = {"psnr": 30.0 + seed, "ssim": 0.9, "lpips": lpips, "edge_psnr": 25.0, "psnr_foreground": 20.0}
    metrics = {"splits": {"test": views, "train": views | {"psnr": 33.0}}, "flicker": None, "render_fps": 50.0, "train_seconds": 40.0}
    metrics |= {"primitives": {"gaussians": 1000, "convexes": 8}, "protocol": {"resolution": "64x64"}}
    machine = {"processor": "P", "load": 0.1, "gpu": "unknown"}
    row = {"seed": seed, "commit": "abc", "code": dict(CODE), "machine": machine, "others": 0.0, "seconds": seconds, "megabytes": 1.5}
    return row | {"metrics": metrics} | changed


def fill(publish, more=(), busy=False, names=("sample",)):
    """The seeds that are measured."""
    publish.fill(list(names), argparse.Namespace(scenes=Path("scenes"), workspace=Path("work"), busy=busy, seeds=3), list(more))
    measured, publish.measured = publish.measured, []
    return [seed for _, seed in measured] if len(names) == 1 else measured


def test_short_runs_have_three_seeds_and_are_not_repeated(publish):
    assert fill(publish) == [0, 1, 2] and fill(publish) == []


def test_all_rows_are_measured_once_before_any_row_again(publish, rows):
    rows.ROWS["other"] = rows.Row("ball", "the ball", "test")
    expected = [(title, seed) for seed in range(3) for title in ("the cube", "the ball")]
    assert fill(publish, names=["sample", "other"]) == expected


def test_a_long_run_has_one_seed(publish):
    publish.takes = 21 * 60.0
    assert fill(publish) == [0] and fill(publish) == []


def test_what_was_interrupted_goes_on(publish, rows):
    rows.keep("sample", {"capture": "cube", "options": [], "device": "cpu", "stale": None, "runs": [run(0), run(1)]})
    assert fill(publish) == [2]


@pytest.mark.parametrize(
    "changed",
    [{"code": CODE | {"coarse": "0" * 16}}, {"code": {}}, {"machine": {"processor": "Q"}}, {"metrics": run(0, lpips=None)["metrics"]}],
    ids=["code", "no code", "machine", "no LPIPS"],
)
def test_a_row_of_other_code_or_another_machine_begins_anew(publish, rows, changed):
    rows.keep(
        "sample", {"capture": "cube", "options": [], "device": "cpu", "stale": None, "runs": [run(seed, **changed) for seed in range(3)]}
    )
    assert fill(publish, more=["--set", "evaluate.lpips_weights=FILE"]) == [0, 1, 2]


FIRST = {"frames": "1" * 64, "seeds": "2" * 64}
OLD = CODE | {"frames": "0" * 16}


@pytest.mark.parametrize(
    ("now", "changed", "measured"),
    [
        (FIRST, {"code": OLD, "contents": FIRST}, []),
        (FIRST | {"seeds": "3" * 64}, {"code": OLD, "contents": FIRST}, [0, 1, 2]),
        (FIRST, {"code": OLD}, [0, 1, 2]),
        (FIRST, {"code": OLD | {"coarse": "0" * 16}, "contents": FIRST}, [0, 1, 2]),
    ],
    ids=["same bits", "other bits", "bits not kept", "training changed too"],
)
def test_code_before_training_that_makes_the_same_bits_leaves_a_row_as_it_is(publish, rows, monkeypatch, now, changed, measured):
    monkeypatch.setattr(publish, "contents", lambda *of: now)
    row = {"capture": "cube", "options": [], "device": "cpu", "stale": "frames", "runs": [run(seed, **changed) for seed in range(3)]}
    rows.keep("sample", row)
    assert fill(publish) == measured and rows.stale("sample", rows.kept("sample")) is None


def test_busy_cores_are_said_and_refused(publish):
    publish.busy = 60.0
    with pytest.raises(SystemExit, match=r"other programs use \d+\.\d cores; .*--busy"):
        fill(publish)
    assert fill(publish, busy=True) == [0, 1, 2]


def test_a_stale_row_names_its_stages(rows):
    row = {"capture": "cube", "options": [], "runs": [run(0), run(1, code=CODE | {"coarse": "0" * 16, "gone": "1"})]}
    assert rows.stale("sample", row) == "coarse, gone"
    assert rows.stale("sample", row | {"runs": [run(0)]}) is None
    assert rows.stale("sample", row | {"options": ["--static"]}) == "another capture or other options"


def test_tables_show_means_and_spreads(rows, publish):
    tables = sys.modules["quality_tables"]
    row = {"capture": "cube", "options": [], "device": "cpu", "stale": "coarse", "runs": [run(0), run(2)]}
    rows.keep("sample", row)
    cells = tables.line(row, "test")
    assert cells[:5] == ["test, 64x64", "2", "31.00", "2.00", "0.9000"] and cells[-1] == "abc (stale)"
    assert "1,000 + 8" in cells and "20.0" in cells and "1.5" in cells
    assert tables.number(None, 2) == "-" and rows.mean({"runs": [run(0), run(1, megabytes=None)]}, lambda r: r["megabytes"]) is None


def test_rows_of_one_commit_say_so_and_what_has_changed_since(rows, publish):
    origin = sys.modules["quality_tables"].origin
    of = {"commit": "abc", "machine": {"processor": "P", "cores": 2, "date": "2026-11-30"}}
    found = {name: {"stale": None, "runs": [run(0, **of)]} for name in ("one", "two")}
    assert origin(found) == "All rows are of commit abc (2026-11-30; P, 2 cores)."
    found["two"]["stale"] = "frames, coarse"
    assert origin(found).endswith("2 cores). The code of coarse, frames has changed since.")
    found["two"]["runs"] = [run(0, **(of | {"commit": "old"}))]
    assert origin(found) == "Rows of an older version: two."
