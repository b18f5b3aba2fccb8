"""`python benchmarks/bench.py`: every row of its own at a tiny size, what is written and drawn."""

import json
import math
from pathlib import Path

import pytest
from bench_rows.plots import draw
from bench_rows.suites import OWN, SUITES
from e4dgs.workflows.bench import suites
from pretended.gpu import pretended_gpu
from script_module import load_script
from simt import needs_compiler

BENCH = Path(__file__).resolve().parents[2] / "benchmarks" / "bench.py"
TINY = ("--scale", "0.001", "--repeats", "1", "--seconds", "0")
COMPILED = {("raster", "limit"), ("raster", "pairs"), *(("cuda", row) for row in OWN["cuda"])}
ROWS = [pytest.param(suite, row, marks=needs_compiler if (suite, row) in COMPILED else ()) for suite, own in OWN.items() for row in own]


@pytest.fixture
def bench():
    return load_script(BENCH).main


@pytest.mark.parametrize(("suite", "row"), ROWS)
def test_every_row_measures_and_writes(bench, tmp_path, capsys, suite, row):
    out = tmp_path / "out.json"
    words = [suite, "--rows", row, "--out", str(out), *TINY]
    if suite == "cuda":
        with pretended_gpu():
            bench(words)
    else:
        bench(words)
    (found,) = json.loads(out.read_text())["rows"].values()
    assert found["protocol"] and (found["checks"] or found["curves"])
    for check in found["checks"]:
        assert check["value"] is not None and math.isfinite(check["value"]), check
    assert row in capsys.readouterr().out


def test_it_knows_the_rows_of_the_command_too(bench, capsys):
    for suite, rows in suites.SUITES.items():
        bench([suite, "--list"])
        names = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
        assert names == [row.name for row in SUITES[suite]] == [*(row.name for row in rows), *OWN[suite]]
        assert len(set(names)) == len(names)


def test_curves_are_drawn_where_a_row_has_some(bench, tmp_path, capsys):
    bench(["raster", "--rows", "determinism,knobs", "--plot", str(tmp_path / "speed.svg"), *TINY])
    assert [path.name for path in tmp_path.iterdir()] == ["speed-knobs.svg"]


def test_a_row_that_is_not_there_is_one_message(bench):
    with pytest.raises(SystemExit, match="--rows nope: there is no such row; rows: garden, convexes, limit"):
        bench(["raster", "--rows", "nope"])


def test_plots_repeat_to_the_byte(tmp_path):
    curves = [
        {"plot": "over_pixels", "label": "Gaussians", "x": [1e3, 1e4], "y": [2.0, 9.0], "x_title": "pixels", "y_title": "ms", "names": []},
        {"plot": "knobs", "label": "SH 0", "x": [3.0], "y": [1e-3], "x_title": "ms", "y_title": "error", "names": ["SH 0"]},
    ]
    rows = {"row": {"curves": curves}, "a row without": {}}
    files = draw(tmp_path / "speed.svg", rows)
    assert [path.name for path in files] == ["speed-over_pixels.svg", "speed-knobs.svg"]
    first = [path.read_bytes() for path in files]
    assert [path.read_bytes() for path in draw(tmp_path / "speed.svg", rows)] == first
