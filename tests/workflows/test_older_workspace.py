"""A real workspace of an earlier version: every command reads it, and a run makes again what is in it, and says why."""

import json
import tarfile
from pathlib import Path

import pytest
from e4dgs.pipeline import Store
from e4dgs.stages.shared.model import read_model
from e4dgs.workflows import cli
from e4dgs.workflows.batch.ledger import Ledger, SceneState
from e4dgs.workflows.batch.listing import Entry

OLDER = Path(__file__).resolve().parents[1] / "older" / "rig-1babdcf.tar.xz"
SETTINGS = ("coarse.iterations=1", "train.motion=free", "seeds.count=40", "hulls.budget=0", "fine.iterations=0")
SETTINGS += ("evaluate.movie_frames=0", "evaluate.max_views=1")
OLD = ("frames", "flow", "coarse", "evaluate")


@pytest.fixture
def old(tmp_path) -> Path:
    """Holds the capture `rig`, and `store` and `scenes` of its workspace."""
    with tarfile.open(OLDER) as archive:
        archive.extractall(tmp_path, filter="data")
    (tmp_path / "scenes" / "rig" / "capture.json").write_text(json.dumps({"path": str(tmp_path / "rig")}))
    return tmp_path


def test_an_old_workspace_is_read_and_its_results_are_made_again(old, monkeypatch, capsys):
    monkeypatch.setattr("signal.signal", lambda *arguments: None)

    def command(*words: str) -> str:
        monkeypatch.setattr(cli, "console", cli.Console(width=400, force_terminal=False))
        assert cli.main([*words, "--workspace", str(old)]) == 0
        return capsys.readouterr().out

    store = Store(old / "store")
    before = dict(store.entries())
    assert before.keys() == set(OLD) and not any(problem for _, _, problem in store.verify())
    assert len(read_model(store.open("coarse", before["coarse"])).gaussians) == 40
    assert all(f"{stage}/{key}" in command("show", "rig", stage) for stage, key in before.items())
    assert "4 results" in command("list")

    words = [str(old / "rig"), "--device", "cpu", *(word for setting in SETTINGS for word in ("--set", setting))]
    rows = {row["stage"]: row for row in json.loads(command("plan", *words, "--json"))["stages"]}
    for stage in OLD:
        assert rows[stage]["state"] == "run" and "made by an earlier version" in rows[stage]["reason"], rows[stage]
    said = command("run", "all", *words)
    assert all(f"{stage}: done in" in said for stage in OLD)
    assert all(len([key for name, key in store.entries() if name == stage]) == 2 for stage in OLD), (
        "what is old stays until it is collected"
    )
    again = json.loads(command("plan", *words, "--json"))["stages"]
    assert {row["state"] for row in again} == {"cached", "skip"}
    new = next(row["key"] for row in again if row["stage"] == "coarse")
    assert "made by an earlier version, whose keys did not include the code" in command("diff", before["coarse"], new)
    assert "made by: version 9, e4dgs" in command("show", before["coarse"]) and "made by: code " in command("show", new)
    assert all(f"would remove {stage}/{key}" in command("gc", "--dry-run") for stage, key in before.items())


def test_the_files_of_a_batch_of_a_later_version_are_read_as_far_as_they_are_known(tmp_path):
    entry = Entry("scene", "/captures/scene", (("coarse.iterations", "5"),), group="scene")
    ledger = Ledger.create(tmp_path, "batch", [entry])
    ledger.write("scene", SceneState("done", "evaluate", "", 12.0, 1))
    for file in (ledger.folder / "batch.json", ledger.folder / "states" / "scene.json"):
        content = json.loads(file.read_text())
        for part in (content, *content.get("scenes", ())):
            part["a later field"] = {"of": ["any", "kind"]}
        file.write_text(json.dumps(content))
    assert ledger.entries() == [entry]
    assert (ledger.progress("scene").state, ledger.progress("scene").seconds) == ("done", 12.0)
    assert Ledger.create(tmp_path, "batch", [entry]).progress("scene").state == "done", "what is done stays done"

    file = ledger.folder / "states" / "scene.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), "state": "resting"}))
    assert ledger.progress("scene").state == "waiting", "a state that is not known is no reason to stop"
    content = json.loads((ledger.folder / "batch.json").read_text())
    content["scenes"] = [{"name": "scene", "capture": "/captures/scene"}]
    (ledger.folder / "batch.json").write_text(json.dumps(content))
    assert ledger.entries() == [Entry("scene", "/captures/scene")], "and of an earlier version, with fewer fields"
