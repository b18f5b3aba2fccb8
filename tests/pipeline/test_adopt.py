"""Results of a second store are taken instead of computed, after every byte has been compared."""

import os
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import pytest
from e4dgs.pipeline import Runner, Store, make_plan
from toy_stages import Bench


@pytest.fixture
def two(bench, tmp_path):
    """A bench on which nothing has been run, and another store in which all of it lies."""
    Runner(bench.job()).run()
    bench.runs()
    other = Store(tmp_path / "other")
    os.rename(bench.store.root, other.root)
    shutil.rmtree(bench.root / "workspace")
    return bench, other


def job(bench: Bench, *others: Store, **settings):
    return replace(bench.job(**settings), also=others)


def everything_in(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_the_plan_says_so_and_the_run_computes_nothing(two):
    bench, other = two
    before = everything_in(other.root)
    rows = make_plan(job(bench, other))
    assert [(row.state, row.reason) for row in rows] == [("cached", f"is taken from {other.root}")] * 4
    assert not (bench.root / "workspace").exists(), "a plan writes nothing"
    said: list[str] = []
    outcomes = Runner(job(bench, other), said.append).run()
    assert bench.runs() == [] and [outcome.state for outcome in outcomes] == ["cached"] * 4
    assert said == [f"{name}: taken from {other.root}" for name in ("numbers", "scaled", "clipped", "total")]
    assert all(outcome.artifact.path.is_relative_to(bench.store.root) for outcome in outcomes)
    assert not any(problem for _, _, problem in bench.store.verify())
    assert everything_in(other.root) == before
    shutil.rmtree(other.root)
    assert set(bench.run().values()) == {"cached"}, "they are ours now"


def test_arrays_are_linked_where_that_can_be_and_the_manifest_is_our_own(two):
    bench, other = two
    path = Runner(job(bench, other)).run()[0].artifact.path
    theirs = other.path("numbers", path.name)
    assert os.path.samefile(path / "values/c/0", theirs / "values/c/0")
    assert not os.path.samefile(path / "manifest.json", theirs / "manifest.json")


def test_between_two_file_systems_they_are_copied(two):
    bench, other = two
    if not os.access("/dev/shm", os.W_OK) or os.stat("/dev/shm").st_dev == os.stat(bench.root).st_dev:
        pytest.skip("needs a second file system: /dev/shm is none here, or cannot be written")
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        there = Store(Path(shutil.copytree(other.root, Path(folder) / "store")))
        path = Runner(job(bench, there)).run()[0].artifact.path
        assert bench.runs() == [] and (path / "values/c/0").stat().st_dev == bench.root.stat().st_dev
    assert not any(problem for _, _, problem in bench.store.verify())


def test_what_only_one_of_them_has_is_combined(two):
    bench, other = two
    shutil.rmtree(other.root / "clipped")
    outcomes = {outcome.stage: outcome.state for outcome in Runner(job(bench, other)).run()}
    assert outcomes == {"numbers": "cached", "scaled": "cached", "clipped": "ran", "total": "cached"}
    assert bench.runs() == ["clipped"]


@pytest.mark.parametrize("file", ["values/c/0", "values/zarr.json", "info.json", "zarr.json", "manifest.json"])
@pytest.mark.parametrize("how", ["flip", "truncate", "delete"])
def test_what_is_damaged_there_is_computed_here_and_left_as_it_is(two, file, how):
    bench, other = two
    key = next(key for stage, key in other.entries() if stage == "numbers")
    path = other.path("numbers", key) / file
    data = path.read_bytes()
    if how == "delete":
        path.unlink()
    else:
        path.write_bytes(data[:-2] if how == "truncate" else bytes([data[0] ^ 1]) + data[1:])
    before = everything_in(other.root)
    said: list[str] = []
    Runner(job(bench, other), said.append).run()
    assert bench.runs() == ["numbers"] and everything_in(other.root) == before
    assert not any(problem for _, _, problem in bench.store.verify()) and not list((bench.store.root / "tmp").iterdir())
    refused = [line for line in said if "not taken" in line]
    if how == "flip" and file != "manifest.json":
        assert len(refused) == 1 and refused[0].startswith(f"numbers: not taken from {other.root}: {path}: ")


def test_a_damaged_result_of_ours_is_replaced_by_a_good_one_of_theirs(two):
    bench, other = two
    path = Runner(job(bench, other)).run()[0].artifact.path / "info.json"
    content = path.read_bytes()
    path.unlink()  # else theirs, which is linked, would be damaged, too
    path.write_bytes(content + b" ")
    said: list[str] = []
    Runner(job(bench, other), said.append).run()
    assert bench.runs() == [] and said[0].startswith(f"numbers: damaged: {path}") and said[1] == f"numbers: taken from {other.root}"


def test_force_computes_all_the_same(two):
    bench, other = two
    Runner(job(bench, other)).run(force=["clipped"])
    assert bench.runs() == ["clipped"]
