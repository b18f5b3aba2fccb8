"""kill -9 of what a batch is made of, on this machine: all scenes finish, and nothing that was committed is computed twice."""

import os
import time

import pytest
from toy_batch import PATIENCE, ToyBatch, wait

SCENES = [f"scene{k}" for k in range(4)]
STEPS = 10  # of 0.1 s
FILE = "lost_after: 8\ncpu: {provider: local, workers: 2, cores: 1}\n"

pytestmark = pytest.mark.timeout(900)  # for machines that are busy with something else


@pytest.fixture(params=["local", "parsl"])
def batch(request, tmp_path):
    words = ["--jobs", "2"]
    if request.param == "parsl":
        pytest.importorskip("parsl")
        (tmp_path / "cluster.yaml").write_text(FILE)
        words = ["--executor", str(tmp_path / "cluster.yaml")]
    made = ToyBatch(tmp_path, SCENES, STEPS, words, os.environ)
    made.hold("scene0", "scene1")  # the others may come first
    yield made
    for process in made.processes():
        process.kill()


def stage(batch: ToyBatch, scene: str):
    """The process that trains a scene."""
    (found,) = batch.processes("run", "coarse", str(batch.folder / scene))
    return found


def test_a_batch_survives_kill_9_of_its_workers_and_twice_of_its_head(batch, request):
    local = "local" in request.node.name
    head = batch.start()
    batch.trains("scene0")
    batch.trains("scene1")
    worker = stage(batch, "scene0")
    (worker if local else worker.parent().parent()).kill()  # a stage is a fork of a server that the worker has started
    if local:  # killed perhaps for want of memory, so it is tried again when it has all there is
        batch.release("scene1")
    batch.trains("scene0", time=2)

    head.kill()
    head.wait()
    wait(lambda: not batch.processes("run"), PATIENCE, "stages end with the head")
    wait(lambda: not batch.processes("e4dgs.workflows.machine.orphan"), PATIENCE, "what passes work on ends with the head")
    states = batch.states()
    assert states["lost"] >= 1 and states["running"] == 0, "what is said of scenes whose head is gone"

    head = batch.start()
    batch.trains("scene0", time=3)
    head.kill()
    head.wait()
    batch.release("scene0", *(() if local else ("scene1",)))
    head = batch.start()  # at once: stages of the head before it may not have ended yet
    assert head.wait(PATIENCE) == 0, batch.said()
    batch.check()
    wait(lambda: not batch.processes(), PATIENCE, "nothing is left behind")


def test_one_at_a_time_works_on_a_scene(tmp_path):
    batch = ToyBatch(tmp_path, ["one"], STEPS, [], os.environ)
    batch.hold("one")
    first = batch.start()
    batch.trains("one")
    second = batch.start()
    until = time.monotonic() + 3
    while time.monotonic() < until:
        assert len(batch.processes("run")) == 1
        time.sleep(0.2)
    batch.release("one")
    assert (first.wait(PATIENCE), second.wait(PATIENCE)) == (0, 0), batch.said()
    batch.check()
