"""`e4dgs bench ablation` on the toy reconstruction, whose PSNR is 20 dB and one more for each step of `fine`; its real rows."""

import csv
import json

import pytest
from e4dgs.pipeline import SettingsError, build_settings, split_assignment
from e4dgs.workflows.bench import ablation as module
from e4dgs.workflows.bench.ablation import ROWS, choose
from e4dgs.workflows.reconstruction import reconstruction


@pytest.mark.parametrize("name", ROWS)
def test_every_row_is_made_of_settings_that_exist(name):
    given = [(f"{stage}.{key}", value) for stage, key, value in map(split_assignment, ROWS[name])]
    settings = build_settings(reconstruction().settings, given)
    assert (settings["hulls"].budget == 0) == name.startswith(("a,", "c,", "d,"))
    assert (settings["fine"].interval_weight == 0) == name.startswith(("a,", "b,", "c,"))
    assert bool(settings["coarse"].interval_weight) == (name.startswith("d,") or name == "full")
    assert bool(settings["hulls"].budget) == (name.startswith("b,") or name == "full")
    assert (settings["fine"].data_flow_weight == 0) == name.startswith(("a,", "b,"))


def test_rows_are_chosen_by_the_beginning_of_their_names():
    assert choose(None) == list(ROWS)
    assert choose("full, a") == ["a, base", "full"]
    with pytest.raises(SettingsError, match=r"--rows e:.*a, base; b, convexes"):
        choose("e")


def test_a_table_is_written_and_rows_that_agree_share_results(cli, capture, tmp_path, monkeypatch):
    monkeypatch.setattr(
        module, "ROWS", {"short": ("fine.iterations=5",), "long": ("fine.iterations=20",), "again": ("fine.iterations=20",)}
    )
    result = cli("bench", "ablation", capture, "--out", tmp_path / "table")
    assert result.code == 0, result.err
    rows = list(csv.DictReader((tmp_path / "table" / "ablation.csv").open()))
    assert [(row["point"], row["seeds"], float(row["psnr"])) for row in rows] == [("short", "1", 25), ("long", "1", 40), ("again", "1", 40)]
    assert len(json.loads((tmp_path / "table" / "ablation.json").read_text())["runs"]) == 3
    page = (tmp_path / "table" / "ablation.html").read_text()
    assert "<td>25.00</td>" in page and "<td>my scene</td>" in page
    assert result.out.count("fine: done in") == 2, "rows that agree run once"


def test_the_row_of_convexes_asks_for_them():
    """By default, captures with control nodes have none: the row would equal the base."""
    asked = [setting for setting in ROWS["b, convexes"] if setting.startswith("hulls.budget=")]
    assert len(asked) == 1 and int(asked[0].removeprefix("hulls.budget=")) > 0
