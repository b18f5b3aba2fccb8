"""The simulation of many scenes keeps to what no schedule can beat, and its page shows what it gave."""

import json
from pathlib import Path

import pytest
from script_module import load_script

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def scale():
    return load_script(ROOT / "benchmarks" / "scale.py")


def test_one_worker_takes_the_sum_and_many_take_the_longest(scale):
    ideal = {"start": 0.0, "lost": 0.0, "gigabits": 1e9, "request": 0.0}
    one = scale.simulate(scale.Cluster(workers=1, **ideal), 20)
    assert one["over_the_least"] == pytest.approx(1) == one["busy_share"] and one["hours"] == pytest.approx(one["worker_hours"])
    many = scale.simulate(scale.Cluster(workers=20, **ideal), 20)
    assert many["over_the_least"] == pytest.approx(1) and many["worker_hours"] == pytest.approx(one["worker_hours"])


def test_a_narrow_store_takes_as_long_as_its_wire(scale):
    found = scale.simulate(scale.Cluster(workers=50, gigabits=0.01), 50)
    assert found["hours"] * 3600 >= found["store_terabytes_moved"] * 8e6 / 10 and found["store_wait_share"] > 0.5


def test_what_is_known_and_what_is_lost_counts(scale):
    half = scale.simulate(scale.Cluster(workers=10, share=0.5), 200)
    whole = scale.simulate(scale.Cluster(workers=10), 200)
    assert 0.35 < half["worker_hours"] / whole["worker_hours"] < 0.65
    lost = scale.simulate(scale.Cluster(workers=10, lost=0.5), 200)
    assert lost["done_again_hours"] > whole["done_again_hours"] and lost["worker_hours"] > whole["worker_hours"]


@pytest.fixture
def result() -> dict:
    return json.loads((ROOT / "benchmarks" / "results" / "scale.json").read_text())


def test_the_result_is_of_what_is_measured_now(scale, result):
    """Both files are committed: a change of stages.json asks for another simulation."""
    assert result["measured_seconds"] == scale.measured(), "stages.json has other seconds: run benchmarks/scale.py again"
    assert result["defaults"] == vars(scale.Cluster()), "run benchmarks/scale.py again"
    row = result["rows"]["100 workers"]
    again = scale.simulate(scale.Cluster(**row["changed"]), result["scenes"])
    assert row == {"changed": row["changed"]} | {name: float(f"{value:.3g}") for name, value in again.items()}, (
        "run benchmarks/scale.py again"
    )


def test_the_page_shows_the_results(scale, result):
    page = (ROOT / "benchmarks" / "results" / "scale.md").read_text()
    assert scale.table(result["rows"]) in page
    lines = " ".join(page.split())
    assert [figure for figure in scale.said(result) if " ".join(figure.split()) not in lines] == [], "scale.md is of other results"
    result["measured_seconds"]["lego"]["coarse"] += 500
    assert [figure for figure in scale.said(result) if " ".join(figure.split()) not in lines] != [], "the figures follow what was measured"
