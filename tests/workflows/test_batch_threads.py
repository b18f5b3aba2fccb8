"""A stage of a batch runs in a process of its own, and takes as many threads as its share of the machine has."""

import os
from pathlib import Path

import pytest
from e4dgs.pipeline import Resources
from e4dgs.workflows.batch import work
from e4dgs.workflows.batch.ledger import Ledger
from e4dgs.workflows.batch.listing import Entry
from e4dgs.workflows.batch.share import Lease
from PIL import Image


@pytest.mark.parametrize("threads", [3, None])
def test_a_stage_sees_the_threads_of_its_share(tmp_path, monkeypatch, threads):
    scene = tmp_path / "scene"
    scene.mkdir()
    for k in range(2):
        Image.new("RGB", (32, 24), (40 * k, 0, 0)).save(scene / f"{k}.png")
    ledger = Ledger.create(tmp_path / "work", "batch", [Entry("scene", str(scene), (("coarse.iterations", "0"),))])
    toys = Path(__file__).parent / "toy_site"
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(toys), *filter(None, [os.environ.get("PYTHONPATH")])]))
    monkeypatch.setenv("OMP_NUM_THREADS", "5")
    (entry,) = ledger.entries()
    ended = work._run(ledger, entry, "coarse", None, Lease(Resources(), threads), lambda: False)
    assert ended.code == 0, ledger.log("scene").read_text()
    said = (tmp_path / "events" / "scene.txt").read_text()
    assert f"coarse begin threads={threads or 5}\n" in said
