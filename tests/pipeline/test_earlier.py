"""Items of an earlier result are taken over where they are what they were; what is new is made, and the plan says how much that is."""

import contextlib
import os
import shutil
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from e4dgs.pipeline import Applies, ArtifactError, Given, Runner, Settings, Stage, StageError, Store, collect, explain, make_plan
from failing import Crash, FailNth
from other_code import edit
from toy_stages import Bench, Numbers, note


class SquaresSettings(Settings):
    plus: int = 0
    none: bool = False


class Squares(Stage):
    """The square of each number, and the largest of all; writes down each number that it had to square."""

    name = "squares"
    inputs = ("numbers",)
    settings = SquaresSettings
    items = "squares"

    def applies(self, facts: Any, settings: SquaresSettings) -> Applies:
        return Applies.yes(f"{facts['count']} numbers")

    def estimate(self, facts: Any, settings: SquaresSettings) -> float:
        return 2.0 * facts.get("new_items", facts["count"])

    def item_parts(self, given: Given) -> list[dict[str, int]]:
        return [{"number": int(value)} for value in given.inputs["numbers"].read("values")]

    def run(self, ctx: Any) -> None:
        values = ctx.inputs["numbers"].read("values")
        if ctx.settings.none:
            ctx.lends = False
            return
        out = ctx.out.create("values", values.shape, np.int64, (1,))
        rows = ctx.earlier.rows if ctx.earlier is not None else {}
        for k, value in enumerate(values):
            if k in rows:
                out[k] = ctx.earlier.artifact.read("values", rows[k])
            else:
                note(ctx, str(value))
                out[k] = value**2 + ctx.settings.plus
        ctx.out.attrs["largest"] = int(out[:].max())


def job(bench: Bench, **settings):
    return bench.job(Numbers(), Squares(), **settings)


def run(bench: Bench, **settings):
    """The artifact of `squares`, and which numbers were squared."""
    bench.runs()
    outcome = Runner(job(bench, **settings)).run()[-1]
    return outcome, [word for word in bench.runs() if word != "numbers"]


def reason(bench: Bench, **settings) -> str:
    return make_plan(job(bench, **settings))[-1].reason


@pytest.fixture
def afresh(tmp_path):
    """The content digest of `squares` for some numbers in an empty store."""

    def digest(numbers: str) -> str:
        other = tmp_path / f"afresh{numbers.replace(' ', '-')}"
        other.mkdir()
        bench = Bench.create(other)
        bench.numbers.write_text(numbers)
        return run(bench)[0].artifact.digest

    return digest


def test_only_what_is_new_is_made_and_the_result_is_that_of_a_fresh_run(bench, afresh):
    assert run(bench)[1] == ["1", "2", "3"]
    bench.numbers.write_text("1 7 2 3")
    outcome, squared = run(bench)
    assert squared == ["7"] and outcome.reason.endswith("; 1 of 4 squares are new")
    assert outcome.partly
    assert outcome.artifact.digest == afresh("1 7 2 3")


def test_the_plan_says_what_it_can_know(bench):
    first, _ = run(bench)
    assert "items" in first.artifact.provenance and first.artifact.provenance["earlier"] is None
    bench.numbers.write_text("1 2 3 4")
    before = make_plan(job(bench))[-1]
    assert before.reason == "after numbers; of 3 squares made before, those that are unchanged are reused" and before.estimate == 8
    Runner(job(bench)).run(["numbers"])
    known = make_plan(job(bench))[-1]
    assert known.reason == "input numbers changed; 1 of 4 squares are new" and known.estimate == 2
    assert explain(job(bench), "squares") == [f"squares would run: {known.reason}"]
    second, _ = run(bench)
    assert second.artifact.provenance["earlier"] == first.artifact.path.name
    assert reason(bench) == "nothing changed"


def test_what_is_forced_is_made_as_a_whole(bench):
    run(bench)
    bench.numbers.write_text("1 2 3 4")
    rows = make_plan(job(bench), force=("squares",))
    assert rows[-1].reason == "after numbers"
    bench.runs()
    Runner(job(bench)).run(force=("squares",))
    assert bench.runs() == ["numbers", "1", "2", "3", "4"]


@pytest.mark.parametrize("what", ["setting", "code", "device"])
def test_a_result_made_otherwise_lends_nothing(bench, monkeypatch, what):
    run(bench)
    bench.numbers.write_text("1 2 3 4")
    Runner(job(bench)).run(["numbers"])
    options = {}
    if what == "setting":
        options = {"squares__plus": 1}
    elif what == "code":
        edit(monkeypatch, Squares, "pipeline/test_earlier.py")
    else:
        monkeypatch.setattr(Squares, "device_class", True)
    assert "are new" not in reason(bench, **options)
    assert run(bench, **options)[1] == ["1", "2", "3", "4"]


def test_the_result_with_most_items_lends_them_whichever_capture_it_is_of(bench):
    for numbers in ("1 2 3 4 5", "1 9"):
        bench.numbers.write_text(numbers)
        run(bench)
    bench.numbers.write_text("1 2 3 4 5 6")
    outcome, squared = run(bench)
    assert squared == ["6"] and outcome.reason.endswith("1 of 6 squares are new")
    shutil.rmtree(bench.root / "workspace" / "scenes")  # as for a capture of another name
    bench.numbers.write_text("2 3 4 5 6 8")
    assert run(bench)[1] == ["8"]


def spoil(store: Store, key: str, chunk: str = "values/c/1") -> None:
    path = store.path("squares", key) / chunk
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def test_damage_is_found_before_anything_is_taken_over(bench, afresh):
    first, _ = run(bench)
    spoil(bench.store, first.artifact.path.name)
    bench.numbers.write_text("1 2 3 4")
    lines: list[str] = []
    outcome = Runner(job(bench), lines.append).run()[-1]
    assert bench.runs()[-4:] == ["1", "2", "3", "4"] and outcome.artifact.digest == afresh("1 2 3 4")
    assert any("nothing is reused" in line and "values/c/1" in line and "moved to" in line for line in lines)
    assert not bench.store.has("squares", first.artifact.path.name)


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), Crash()], ids=["error", "crash"])
def test_failing_while_a_damaged_lender_is_set_aside_leaves_one_of_it_and_no_damage_elsewhere(quick_folder, error):
    bench = Bench.create(quick_folder)
    place = run(bench)[0].artifact.path
    bench.numbers.write_text("1 2 3 4")
    Runner(job(bench)).run(["numbers"])
    before = shutil.copytree(bench.store.root.parent, quick_folder / "before")
    for n in range(1, 200):
        shutil.rmtree(bench.store.root.parent)
        shutil.copytree(before, bench.store.root.parent)
        spoil(bench.store, place.name)
        with FailNth(n, error, bench.store.root).patched() as failure, contextlib.suppress(StageError, OSError, Crash):
            Runner(job(bench)).run()
        copies = [path for path in (place, *(bench.store.root / "quarantine").glob("*")) if path.is_dir()]
        assert len(copies) == 1 and len([path for path in copies[0].rglob("*") if path.is_file()]) == 7, "whole, here or there"
        made = Runner(job(bench)).run()[-1].artifact
        assert made.read("values").tolist() == [1, 4, 9, 16]
        assert [entry for *entry, problem in bench.store.verify() if problem] in ([], [["squares", place.name]])
        if not failure.failed:
            break
    assert n > 10, "the loop must have failed at many places before it got through"


def test_the_next_best_serves_where_the_best_is_damaged(bench):
    run(bench)
    bench.numbers.write_text("1 2 3 4")
    best, _ = run(bench)
    spoil(bench.store, best.artifact.path.name)
    bench.numbers.write_text("1 2 3 4 5")
    outcome, squared = run(bench)
    assert squared == ["4", "5"] and outcome.reason.endswith("2 of 5 squares are new")


def test_another_store_lends_items_and_is_only_read(bench, tmp_path, afresh):
    first, _ = run(bench)
    other = Store(tmp_path / "other")
    os.rename(bench.store.root, other.root)
    shutil.rmtree(bench.root / "workspace")
    bench.numbers.write_text("1 2 3 4")
    before = {path: path.stat().st_mtime_ns for path in sorted(other.root.rglob("*"))}
    bench.runs()
    outcome = Runner(replace(job(bench), also=[other])).run()[-1]
    assert bench.runs() == ["numbers", "4"] and outcome.artifact.digest == afresh("1 2 3 4")
    assert {path: path.stat().st_mtime_ns for path in sorted(other.root.rglob("*"))} == before

    spoil(other, first.artifact.path.name)
    shutil.rmtree(bench.root / "workspace")
    lines: list[str] = []
    assert Runner(replace(job(bench), also=[other]), lines.append).run()[-1].artifact.digest == outcome.artifact.digest
    assert bench.runs() == ["numbers", "1", "2", "3", "4"] and other.has("squares", first.artifact.path.name)
    assert not any("moved to" in line for line in lines)


def test_what_items_are_taken_from_stays_while_it_is_used(bench, monkeypatch):
    first, _ = run(bench)
    taken: list[int] = []
    original = Squares.run

    def while_collecting(self, ctx: Any) -> None:
        taken.append(len(collect(bench.store, lambda: ()).removed))
        original(self, ctx)

    del first
    monkeypatch.setattr(Squares, "run", while_collecting)
    bench.numbers.write_text("1 2 3 4")
    assert run(bench)[1] == ["4"]
    assert taken == [1], "the numbers of the first run alone"


def test_a_run_that_died_takes_over_what_it_would_have(bench, monkeypatch):
    run(bench)
    bench.numbers.write_text("1 2 3 4")
    original = Squares.run
    monkeypatch.setattr(Squares, "run", lambda self, ctx: original(self, ctx) or ctx.inputs["numbers"].read("gone"))
    with pytest.raises(ArtifactError, match="there is no array 'gone'"):
        Runner(job(bench)).run()
    monkeypatch.setattr(Squares, "run", original)
    assert run(bench)[1] == ["4"]


def test_a_result_without_items_lends_none(bench):
    run(bench, squares__none=True)
    bench.numbers.write_text("1 2 3 4")
    Runner(job(bench)).run(["numbers"])
    assert reason(bench, squares__none=True) == "input numbers changed"


def test_damaged_inputs_are_mended_first(bench, afresh):
    """What tells the items is itself read from an input."""
    run(bench)
    bench.numbers.write_text("1 2 3 4")
    numbers = Runner(job(bench)).run(["numbers"])[0].artifact
    chunk = numbers.path / "values" / "c" / "0"
    chunk.write_bytes(bytes(len(chunk.read_bytes())))
    del numbers
    assert "are new" not in reason(bench)
    outcome, squared = run(bench)
    assert squared == ["4"] and outcome.artifact.digest == afresh("1 2 3 4")
