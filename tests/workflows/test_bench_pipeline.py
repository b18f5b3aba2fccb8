"""`e4dgs bench pipeline` on the toy reconstruction, whose PSNR is 20 dB and one more for each step of `fine`."""

import json
import sys

import pytest
from e4dgs.pipeline import SettingsError
from e4dgs.workflows.bench.pipeline import Run, parse_points, summaries


def run(seed: int = 0, seconds: float = 10.0, **splits: float) -> Run:
    return Run("lego", "fast", seed, seconds, 8.0, 100, 2, "400x400", {name: {"psnr": psnr} for name, psnr in splits.items()})


def test_every_capture_is_run_at_every_point(cli, capture, tmp_path):
    out, plot = tmp_path / "curve.json", tmp_path / "curve.svg"
    points = "fine.iterations=5,fine.iterations=20"
    result = cli("bench", "pipeline", capture, "--points", points, "--out", out, "--plot", plot)
    assert result.code == 0, result.err
    assert "my scene" in result.out and "25.00" in result.out and "40.00" in result.out
    content = json.loads(out.read_text())
    assert [(p["point"], p["psnr"]) for p in content["points"]] == [("fine.iterations=5", 25.0), ("fine.iterations=20", 40.0)]
    assert len(content["runs"]) == 2 and "machine" in content
    assert plot.read_text().startswith("<?xml") and "my scene" in plot.read_text()
    again = cli("bench", "pipeline", capture, "--points", points)
    assert "done in" not in again.out, "results in the workspace are reused"


def test_points_are_presets_or_settings():
    assert parse_points("fast, coarse.effort=0.4+hulls.budget=0") == [
        ("fast", "fast", ()),
        ("coarse.effort=0.4+hulls.budget=0", "default", ("coarse.effort=0.4", "hulls.budget=0")),
    ]
    with pytest.raises(SettingsError, match=r"quick.*neither a preset.*fast.*nor a setting"):
        parse_points("quick")
    with pytest.raises(SettingsError, match="no point"):
        parse_points(",")


def test_a_plot_of_another_kind_is_refused_before_anything_runs(cli, capture, tmp_path):
    result = cli("bench", "pipeline", capture, "--plot", tmp_path / "curve.gif")
    assert result.code == 2 and ".svg or .png" in result.err and not (tmp_path / "e4dgs-workspace").exists()


def test_a_plot_without_matplotlib_is_refused_before_anything_runs(cli, capture, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    result = cli("bench", "pipeline", capture, "--plot", tmp_path / "curve.svg")
    assert result.code == 2 and "pip install 'e4dgs[bench]'" in result.err and len(result.err.splitlines()) == 1
    assert not (tmp_path / "e4dgs-workspace").exists()


def test_seeds_are_averaged_and_held_out_views_come_first():
    rows = summaries([run(0, 10, train=30, val=24, test=20), run(1, 20, train=32, val=26, test=23)])
    assert len(rows) == 1
    row = rows[0]
    assert (row["seeds"], row["seconds"], row["psnr"], row["spread"], row["train_psnr"]) == (2, 15, 21.5, 3, 31)
    assert row["lpips"] is None
    assert summaries([run(val=24, train=30)])[0]["psnr"] == 24
    assert summaries([run(train=30)])[0]["psnr"] == 30
