"""What runs again and what does not, and what the plan says about it."""

import os
from dataclasses import replace

import pytest
from e4dgs.pipeline import CaptureError, Graph, Runner, SettingsError, StageError, explain, make_plan
from e4dgs.pipeline.job import Job
from e4dgs.pipeline.records import differences
from other_code import edit
from toy_stages import Careless, Clipped, Failing, Numbers, Scaled, Slow, Total

ALL = ["numbers", "scaled", "clipped", "total"]


def states(job: Job, **options) -> dict[str, str]:
    return {row.stage: row.state for row in make_plan(job, **options)}


def reason(job: Job, stage: str) -> str:
    return next(row.reason for row in make_plan(job) if row.stage == stage)


def test_a_first_run_runs_everything_and_a_second_nothing(bench):
    assert set(bench.run().values()) == {"ran"}
    assert bench.runs() == ALL
    assert set(bench.run().values()) == {"cached"}
    assert bench.runs() == []


def test_touching_a_file_changes_nothing(bench):
    bench.run()
    os.utime(bench.numbers, (1, 1))
    assert set(bench.run().values()) == {"cached"}


def test_moving_the_capture_changes_nothing(bench):
    bench.run()
    bench.numbers.parent.rename(bench.root / "elsewhere")
    job = bench.job()
    job.capture.root = bench.root / "elsewhere"
    assert {outcome.state for outcome in Runner(job).run()} == {"cached"}


def test_a_changed_setting_reruns_only_what_depends_on_it(bench):
    bench.run()
    bench.runs()
    bench.run(clipped__limit=1)
    assert bench.runs() == ["clipped", "total"]
    bench.run(scaled__factor=3)
    assert bench.runs() == ["scaled"]


def test_going_back_to_old_settings_runs_nothing(bench):
    bench.run()
    bench.run(clipped__limit=1)
    bench.runs()
    assert bench.run()["clipped"] == "cached"
    assert bench.runs() == []


def test_an_equal_result_stops_the_rerun(bench):
    bench.numbers.write_text("5 6 7")
    bench.run()
    bench.runs()
    assert bench.run(numbers__offset=1) == {"numbers": "ran", "scaled": "ran", "clipped": "ran", "total": "cached"}
    assert bench.runs() == ["numbers", "scaled", "clipped"]


def test_a_changed_capture_reruns_its_readers(bench):
    bench.run()
    bench.numbers.write_text("1 2 4")
    job = bench.job()
    assert reason(job, "numbers") == "the content of the capture's files changed"
    assert bench.run()["numbers"] == "ran"


def test_other_code_of_a_stage_reruns_it(bench, monkeypatch):
    bench.run()
    bench.runs()
    edit(monkeypatch, Clipped, "toy_stages.py")
    assert reason(bench.job(), "clipped") == "toy_stages.py has changed"
    bench.run()
    assert bench.runs() == ["clipped"]


def test_the_device_counts_only_where_a_stage_says_so(bench):
    bench.run()
    assert states(bench.job(device="cuda")) == {"numbers": "cached", "scaled": "run", "clipped": "cached", "total": "cached"}
    assert reason(bench.job(device="cuda"), "scaled") == "device: cpu -> cuda"


def test_force_runs_a_cached_stage_and_an_equal_result_ends_there(bench):
    bench.run()
    bench.runs()
    job = bench.job()
    outcomes = {outcome.stage: outcome.state for outcome in Runner(job).run(force=("numbers",))}
    assert bench.runs() == ["numbers"]
    assert outcomes == {"numbers": "ran", "scaled": "cached", "clipped": "cached", "total": "cached"}


def test_running_one_stage_runs_only_what_it_needs(bench):
    Runner(bench.job()).run(["clipped"])
    assert bench.runs() == ["numbers", "clipped"]


def test_a_skipped_stage_arrives_as_none_and_says_why(bench):
    outcomes = {outcome.stage: outcome for outcome in Runner(bench.job(clipped__skip=True)).run()}
    assert (outcomes["clipped"].state, outcomes["clipped"].reason) == ("skipped", "clipped.skip is set")
    assert outcomes["total"].artifact.attrs["total"] is None
    assert states(bench.job(clipped__skip=True))["clipped"] == "skip"


def test_a_skipped_stage_keeps_no_record_of_an_earlier_run(bench):
    bench.run()
    key = bench.job().records.read("clipped")["key"]
    bench.run(clipped__skip=True)
    assert bench.job().records.read("clipped") is None and bench.job().records.read("total") is not None
    assert reason(bench.job(clipped__limit=7), "clipped") == "the last run skipped it"
    assert reason(bench.job(numbers__offset=3), "clipped") == "the last run skipped it; after numbers"
    assert bench.store.has("clipped", key), "the result itself stays in the store"
    bench.runs()
    assert explain(bench.job(), "clipped") == ["clipped would be reused: was made before with the same inputs and settings"]
    assert bench.run()["clipped"] == "cached" and bench.runs() == []
    assert bench.job().records.read("clipped")["key"] == key


def test_the_plan_knows_the_reasons_and_writes_nothing(bench):
    job = bench.job()
    assert states(job) == dict.fromkeys(ALL, "run")
    assert reason(job, "numbers") == "never run for this scene"
    assert reason(job, "total") == "never run for this scene; after clipped"
    assert next(row for row in make_plan(job) if row.stage == "total").estimate == 1.5
    assert not (bench.root / "workspace").exists()


def test_the_plan_names_the_setting_that_changed_and_what_waits_for_it(bench):
    bench.run()
    job = bench.job(numbers__offset=3)
    assert reason(job, "numbers") == "settings.offset: 0 -> 3"
    assert reason(job, "clipped") == "after numbers"
    assert reason(bench.job(numbers__offset=3, clipped__limit=9), "clipped") == "settings.limit: 2 -> 9; after numbers"


def test_why_follows_the_cause_upwards(bench):
    bench.run()
    assert explain(bench.job(), "total") == ["total would be reused: nothing changed"]
    assert explain(bench.job(numbers__offset=3), "total") == [
        "total would run: after clipped",
        "  clipped would run first: after numbers",
        "  numbers would run first: settings.offset: 0 -> 3",
    ]
    with pytest.raises(SettingsError, match="no stage 'totel'; stages: numbers, scaled"):
        explain(bench.job(), "totel")


def test_a_result_that_was_removed_is_made_again_and_the_plan_says_so(bench):
    bench.run()
    key = next(row.key for row in make_plan(bench.job()) if row.stage == "clipped")
    assert bench.store.take("clipped", key, "tmp")
    assert reason(bench.job(), "clipped") == "its result is no longer in the store"
    assert bench.run()["clipped"] == "ran"


def test_a_failing_stage_names_itself_and_leaves_nothing(bench):
    job = bench.slow(fail_at=3)
    with pytest.raises(StageError, match="slow failed: ZeroDivisionError: step went wrong"):
        Runner(job).run()
    assert not list((job.store.root / "tmp").iterdir())
    assert [stage for stage, _ in job.store.entries()] == ["numbers"]
    with pytest.raises(StageError, match=r"^frame 3: no luck; try another$"):
        Runner(bench.job(Failing())).run()


def test_a_bad_capture_is_its_own_error(bench):
    bench.numbers.write_text("1 two")
    with pytest.raises(CaptureError, match=r"numbers\.txt: .* correct the file"):
        Runner(bench.job()).run()
    bench.numbers.unlink()
    job = bench.job()
    job.capture = replace(job.capture)
    with pytest.raises(CaptureError, match=r"numbers\.txt: cannot be read"):
        job.parts(Numbers(), {})


def test_a_stage_that_forgets_a_chunk_fails(bench):
    with pytest.raises(StageError, match="careless: array 'part': 2 of its 3 chunks were never written"):
        Runner(bench.job(Careless())).run()
    assert bench.store.entries() == []


def test_provenance_tells_how_a_result_was_made(bench):
    outcomes = Runner(bench.job(), code_version="1.2.3").run()
    made = outcomes[1].artifact.provenance
    assert made["seeds"] == {"seed": 7} and made["settings"]["factor"] == 2.0
    assert made["code_version"] == "1.2.3" and {"python", "numpy", "zarr"} <= made["libraries"].keys()
    assert made["parts"]["inputs"] == {"numbers": outcomes[0].artifact.digest}
    assert made["seconds"] > 0 and 10 < made["peak_rss_mb"] < 10_000


def test_a_graph_lists_inputs_first():
    with pytest.raises(ValueError, match="stage total reads clipped, which must be listed before it"):
        Graph([Numbers(), Total()])
    with pytest.raises(ValueError, match="slow is listed twice"):
        Graph([Numbers(), Slow(), Slow()])
    assert [stage.name for stage in Graph([Numbers(), Scaled(), Slow()]).needed_for(["slow"])] == ["numbers", "slow"]


def test_what_became_of_an_input_is_said():
    old = {"inputs": {"poses": None, "flow": "a", "coarse": "b", "hulls": "c"}}
    new = {"inputs": {"poses": "d", "flow": None, "coarse": "e", "masks": "f", "edges": None}}
    assert differences(old, new) == [
        "input coarse changed",
        "input edges: no input -> skipped",
        "input flow: there -> skipped",
        "input hulls: there -> no input",
        "input masks: no input -> there",
        "input poses: skipped -> there",
    ]
