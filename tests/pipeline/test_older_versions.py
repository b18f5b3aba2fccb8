"""Workspaces of earlier versions: their results are reused, or made again for a reason that is said."""

import json
import zipfile
from pathlib import Path

import pytest
from e4dgs.pipeline import Artifact, DamagedError, Runner, collect, explain, make_plan
from e4dgs.pipeline.storage.artifact import seal
from toy_stages import Bench, Clipped

OLDER = Path(__file__).resolve().parents[1] / "older"


@pytest.fixture(params=["toy-2ef02ac.zip", "toy-1babdcf.zip"])
def old(request, tmp_path) -> Bench:
    bench = Bench.create(tmp_path)
    with zipfile.ZipFile(OLDER / request.param) as archive:
        archive.extractall(bench.root / "workspace")
    return bench


def test_results_of_older_versions_are_read_and_reused(old):
    assert len(old.store.entries()) == 4 and not any(problem for _, _, problem in old.store.verify())
    assert {(row.state, row.reason) for row in make_plan(old.job())} == {("cached", "nothing changed")}
    outcomes = Runner(old.job()).run()
    assert old.runs() == [] and [outcome.state for outcome in outcomes] == ["cached"] * 4
    assert outcomes[1].artifact.read("values").tolist() == [2, 4, 6] == outcomes[1].artifact.array("values")[...].tolist()
    assert outcomes[3].artifact.attrs == {"total": 5} and outcomes[0].artifact.provenance["seconds"] > 0


def test_a_new_version_of_a_stage_says_so_and_leaves_the_old_result(old, monkeypatch):
    monkeypatch.setattr(Clipped, "version", 2)
    assert explain(old.job(), "clipped") == ["clipped would run: version: 1 -> 2"]
    old.run()
    assert old.runs() == ["clipped"] and len([stage for stage, _ in old.store.entries() if stage == "clipped"]) == 2
    assert [item.stage for item in collect(old.store, lambda: {(row.stage, row.key) for row in make_plan(old.job())}).removed] == [
        "clipped"
    ]


def test_a_result_of_a_format_that_is_not_known_is_made_again_and_kept(old):
    """As a later version may write it: whole, but not ours to read."""
    path = Runner(old.job()).run()[2].artifact.path
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
