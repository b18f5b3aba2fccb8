"""Workspaces of earlier versions: their results are read, and made again for a reason that is said."""

import json
import zipfile
from pathlib import Path

import pytest
from e4dgs.pipeline import Artifact, DamagedError, Runner, collect, explain, make_plan
from e4dgs.pipeline.storage.artifact import seal
from toy_stages import Bench

OLDER = Path(__file__).resolve().parents[1] / "older"


@pytest.fixture(params=["toy-2ef02ac.zip", "toy-1babdcf.zip"])
def old(request, tmp_path) -> Bench:
    bench = Bench.create(tmp_path)
    with zipfile.ZipFile(OLDER / request.param) as archive:
        archive.extractall(bench.root / "workspace")
    return bench


def test_results_of_older_versions_are_read(old):
    assert len(old.store.entries()) == 4 and not any(problem for _, _, problem in old.store.verify())
    found = {stage: old.store.open(stage, key) for stage, key in old.store.entries()}
    assert found["scaled"].read("values").tolist() == [2, 4, 6] == found["scaled"].array("values")[...].tolist()
    assert found["total"].attrs == {"total": 5} and found["numbers"].provenance["seconds"] > 0


def test_they_are_made_again_since_nobody_knows_by_which_code_they_were_made(old):
    assert explain(old.job(), "numbers") == ["numbers would run: made by an earlier version, whose keys did not include the code"]
    digests = {stage: old.store.open(stage, key).digest for stage, key in old.store.entries()}
    outcomes = Runner(old.job()).run()
    assert {outcome.stage: outcome.artifact.digest for outcome in outcomes} == digests, "what is computed is the same"
    assert sorted(old.runs()) == sorted(digests) and len(old.store.entries()) == 8
    assert {row.state for row in make_plan(old.job())} == {"cached"}
    removed = collect(old.store, lambda: {(row.stage, row.key) for row in make_plan(old.job())}).removed
    assert sorted(item.stage for item in removed) == sorted(digests)


def test_a_result_of_a_format_that_is_not_known_is_made_again_and_kept(old):
    """As a later version may write it: whole, but not ours to read."""
    path = Runner(old.job()).run()[2].artifact.path
    old.runs()
    manifest = json.loads((path / "manifest.json").read_text())
    manifest["format"] = 2
    manifest["seal"] = seal(manifest)
    (path / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(DamagedError, match=r"manifest\.json: it has format 2, and this version reads format 1"):
        Artifact(path)
    row = make_plan(old.job())[2]
    assert row.state == "run" and "it has format 2, and this version reads format 1" in row.reason
    said: list[str] = []
    Runner(old.job(), said.append).run()
    assert old.runs() == ["clipped"] and "format 2" in said[0] and "quarantine" in said[0]
    (place,) = (old.store.root / "quarantine").iterdir()
    assert json.loads((place / "manifest.json").read_text()) == manifest
