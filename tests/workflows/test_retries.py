"""How often a stage is tried on a cluster: its own failures count, workers that were lost under it do not."""

import os
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from e4dgs.workflows.batch.ledger import Ledger
from PIL import Image
from slurm_cluster import wait

pytest.importorskip("parsl")
PATIENCE = 200.0  # s; for machines that are busy with something else


def capture(folder: Path) -> None:
    folder.mkdir()
    for i in range(2):
        Image.new("RGB", (16, 12), (40 * i, len(folder.name), 0)).save(folder / f"{i}.png")


def words_of(process: psutil.Process) -> list[str]:
    try:
        return process.cmdline()
    except psutil.Error:
        return []


@pytest.mark.timeout(600)
def test_a_stage_is_tried_once_more_than_retries_whatever_workers_are_lost(tmp_path):
    """Two tries are allowed. Training of "always" fails at each. That of "once" fails, then loses its worker, and then does its work."""
    events, work = tmp_path / "events", tmp_path / "work"
    events.mkdir()
    (events / "once.hold").touch()
    for name in ("always", "once"):
        capture(tmp_path / name)
    (tmp_path / "scenes.yaml").write_text(
        "settings: {coarse.iterations: 2, coarse.seconds: 0.01}\n"
        "scenes: [{capture: always, settings: {coarse.failures: 9}}, {capture: once, settings: {coarse.failures: 1}}]\n"
    )
    (tmp_path / "cluster.yaml").write_text("retries: 1\nlost_after: 4\ncpu: {provider: local, workers: 2, cores: 1}\n")
    toys = Path(__file__).parent / "toy_site"
    path = os.pathsep.join([str(toys), *filter(None, [os.environ.get("PYTHONPATH")])])
    command = [sys.executable, "-m", "e4dgs.workflows.cli", "batch", str(tmp_path / "scenes.yaml"), "--workspace", str(work)]
    command += ["--executor", str(tmp_path / "cluster.yaml")]

    def told(scene: str, what: str) -> int:
        file = events / f"{scene}.txt"
        return file.read_text().count(what) if file.is_file() else 0

    with open(tmp_path / "head.txt", "wb") as log:
        head = subprocess.Popen(command, env=dict(os.environ, PYTHONPATH=path), stdout=log, stderr=log)
    try:
        wait(lambda: told("once", "coarse step"), PATIENCE, "the second try trains")
        (stage,) = (one for one in psutil.process_iter() if {"coarse", str(tmp_path / "once")} <= set(words_of(one)))
        worker = stage.parent()
        assert worker is not None and "multiprocessing" in " ".join(words_of(worker))
        worker.kill()  # before the stage, whose end would otherwise count as its own
        stage.kill()
        (events / "once.hold").unlink()
        assert head.wait(PATIENCE) == 1, (tmp_path / "head.txt").read_text()
    finally:
        head.terminate()
        head.wait(PATIENCE)
    always, once = (Ledger(work, "batch").progress(name) for name in ("always", "once"))
    assert (always.state, always.stage, always.attempts) == ("failed", "coarse", 2) and "this is try 2" in always.message
    assert told("always", "coarse begin") == 2 and not told("always", "evaluate begin"), "what comes after is not tried at all"
    assert (once.state, once.attempts) == ("done", 2)
    assert (told("once", "coarse begin"), told("once", "coarse step")) == (3, 2), "and it went on from its checkpoint"
