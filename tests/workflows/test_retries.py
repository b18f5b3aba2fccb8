"""How often a stage is tried on a cluster: its own failures count, workers that were lost under it do not."""

import contextlib
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


def words_of(process: psutil.Process) -> list[str]:
    try:
        return " ".join(process.cmdline()).split()  # a fork says all of it in one word
    except psutil.Error:
        return []


@pytest.mark.timeout(600)
def test_a_stage_is_tried_once_more_than_retries_whatever_workers_are_lost(tmp_path):
    """Two tries are allowed: training loses its worker, and then fails twice."""
    events, capture, work = (tmp_path / name for name in ("events", "scene", "work"))
    for folder in (events, capture):
        folder.mkdir()
    (events / "scene.hold").touch()
    for i in range(2):
        Image.new("RGB", (16, 12), (40 * i, 0, 0)).save(capture / f"{i}.png")
    (tmp_path / "cluster.yaml").write_text("retries: 1\nlost_after: 4\ncpu: {provider: local, cores: 1}\n")
    toys = Path(__file__).parent / "toy_site"
    path = os.pathsep.join([str(toys), *filter(None, [os.environ.get("PYTHONPATH")])])
    command = [sys.executable, "-m", "e4dgs.workflows.cli", "batch", str(capture), "--workspace", str(work)]
    command += ["--executor", str(tmp_path / "cluster.yaml"), "--set", "coarse.iterations=2", "--set", "coarse.fails=true"]

    def told(what: str) -> int:
        file = events / "scene.txt"
        return file.read_text().count(what) if file.is_file() else 0

    with open(tmp_path / "head.txt", "wb") as log:
        head = subprocess.Popen(command, env=dict(os.environ, PYTHONPATH=path), stdout=log, stderr=log)
    try:
        wait(lambda: told("coarse step"), PATIENCE, "the scene trains")
        (stage,) = (one for one in psutil.process_iter() if {"coarse", str(capture)} <= set(words_of(one)))
        worker = stage.parent().parent()  # a stage is a fork of a server that the worker has started
        assert worker is not None and "multiprocessing" in " ".join(words_of(worker))
        worker.kill()  # before the stage, whose end would otherwise count as its own
        with contextlib.suppress(psutil.Error):  # it may have ended by itself
            stage.kill()
        (events / "scene.hold").unlink()
        assert head.wait(PATIENCE) == 1, (tmp_path / "head.txt").read_text()
    finally:
        head.terminate()
        head.wait(PATIENCE)
    progress = Ledger(work, "batch").progress("scene")
    assert (told("coarse begin"), told("coarse step")) == (3, 2), "the lost worker cost no try, and no step"
    assert (progress.state, progress.stage, progress.message) == ("failed", "coarse", "the toy fails, as it was told to")
    assert progress.attempts == 2 and not told("evaluate begin"), "what comes after is not tried at all"
