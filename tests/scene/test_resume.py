"""A training that was killed and continued ends with the bytes of one that was not."""

import signal
import subprocess
import sys
from functools import cache

import interrupted
import pytest
import torch
from e4dgs.scene.motion.nodes.control_nodes import ControlNodes
from e4dgs.scene.motion.nodes.schedule import FIRST_MOTION, NODES
from e4dgs.scene.motion.phases import Phase
from e4dgs.scene.training import convergence
from e4dgs.scene.training.checkpoint import FILE
from interrupted import EVERY, KINDS, QUICK, ROUNDS, Dying, Killed, digests, prepared, run
from sliding_gaussians import fresh, make_views, wandering_views


@cache
def whole(kind: str) -> Dying:
    """Never killed, and without checkpoints."""
    return run(prepared(kind, None))


def continued(trainer: Dying) -> list[str]:
    return [event for event in trainer.log.events if event.startswith("continued from")]


@pytest.mark.parametrize("kind", KINDS)
def test_a_training_that_is_killed_again_and_again_ends_as_if_nothing_had_happened(kind, tmp_path):
    """Before the first checkpoint; inside a round of density control; inside or after the next one, so that a whole round is lost; right
    after a round which a checkpoint precedes. Each time some of the 37 steps between two checkpoints are lost."""
    want = whole(kind)
    changed = {step for step, before, after in want.rounds if before != after}
    assert [step for step, _, _ in want.rounds] == list(ROUNDS) and changed >= ({200} if kind == "fine" else {200, 210, 220})
    begun = []
    for dies in [("after", 20), ("inside", 200), ("after" if kind == "fine" else "inside", 210), ("after", 230)]:
        trainer = prepared(kind, tmp_path, dies)
        with pytest.raises(Killed):
            run(trainer)
        assert trainer.iteration == dies[1]
        begun += continued(trainer)[-1:]
    again = run(prepared(kind, tmp_path))
    steps = [int(event.split("step ")[1].split()[0]) for event in begun + continued(again)[-1:]]
    assert steps == [5 * EVERY, 5 * EVERY, 6 * EVERY], "three continued, from the last checkpoint before each death"
    assert digests(again) == digests(want)


def test_these_trainings_hold_what_could_be_lost():
    """Motion of every kind that was renewed, colours of cameras, convexes, in the end and away from where they began."""
    nodes, fine = whole("nodes"), whole("fine")
    assert sum("the motion was spread" in event for event in nodes.log.events) == len(NODES.spread_at)
    for kind in ("planes", "lifetimes", "fine"):
        assert float(whole(kind).model.affine.offset.detach().abs().max()) > 1e-4
    assert len(fine.model.convexes) and {bool(d) for d in fine.model.convexes.dynamic} == {True}
    assert float(whole("lifetimes").model.gaussians.velocities.detach().abs().max()) > 1e-4


def test_a_process_that_is_killed_while_it_saves_is_continued_by_another(tmp_path):
    """A real SIGKILL, when the new checkpoint is written and not yet in its place; several rounds of density control are lost with it."""

    def process(*dies: object) -> subprocess.CompletedProcess:
        words = [interrupted.__file__, "lifetimes", tmp_path, torch.get_num_threads(), *dies]
        return subprocess.run([sys.executable, *map(str, words)], capture_output=True, text=True)

    killed = process("saving", 6 * EVERY)
    assert killed.returncode == -signal.SIGKILL and not killed.stdout, killed.stderr
    assert {path.name for path in tmp_path.iterdir()} == {FILE, f".{FILE}.tmp"}
    ended = process()
    assert ended.returncode == 0, ended.stderr
    *found, last = ended.stdout.splitlines()
    assert last.startswith(f"continued continued from the checkpoint at step {5 * EVERY} of")
    assert dict(line.split() for line in found) == digests(whole("lifetimes"))


def test_writing_checkpoints_changes_nothing(tmp_path):
    """Nodes that do not move yet: what would carry the primitives is searched when it is needed, not for a checkpoint."""

    def training(folder, every) -> Dying:
        views = wandering_views(9, 16)
        model = fresh(views, static=True)
        model.gaussians.dynamic[:] = True
        model.motion = ControlNodes.over(model.gaussians.means.detach().numpy(), QUICK.seed)
        phases = [Phase("warm-up", 60, False, 0.5), Phase("deformation", 39, True, 0.5)]
        settings = QUICK.model_copy(update={"checkpoint_seconds": every, "lr_means": 4e-2})
        return run(Dying(model, views, phases, settings, budget=90, recipe=FIRST_MOTION, checkpoints=folder))

    want = training(None, 1.0)
    assert digests(training(tmp_path, 19.5)) == digests(want) and (tmp_path / FILE).is_file()


def test_a_training_that_goes_on_keeps_its_unit_of_length(tmp_path):
    """Rates and losses are in viewing distances of the model as training began. An earlier part may have made that model, and is not
    repeated."""
    whole = run(prepared("nodes", tmp_path))
    views = wandering_views(9, 16)
    other = fresh(views, static=True)
    with torch.no_grad():
        other.gaussians.means.mul_(7.0)
    other.motion = ControlNodes.over(other.gaussians.means.detach().numpy(), QUICK.seed)
    again = Dying(other, views, whole.phases, QUICK, budget=90, recipe=NODES, checkpoints=tmp_path)
    assert again.unit == again.objective.run.unit == whole.unit
    begun = Dying(other, views, whole.phases, QUICK, budget=90, recipe=NODES)
    assert abs(begun.unit / whole.unit - 1) > 0.05


def test_a_damaged_checkpoint_is_told_of(tmp_path):
    (tmp_path / FILE).write_bytes(b"torn")
    trainer = prepared("planes", tmp_path)
    assert trainer.log.events == [f"the checkpoint {tmp_path / FILE} cannot be read, so training starts over"]
    assert not prepared("planes", tmp_path / "none").log.events


REST, HALF, FULL = Phase("rest", 240, False), Phase("half", 450, False, 0.5), Phase("full", 150, False)
CONVERGING = {  # phases, places of death, the last step
    "the only phase": ([REST], [("saved", 200)], 200),
    "a phase before another": ([HALF, FULL], [("saved", 300), ("after", 380)], 450),
}


@pytest.mark.parametrize(("phases", "deaths", "last"), CONVERGING.values(), ids=CONVERGING)
def test_what_has_converged_stays_so_after_a_kill(phases, deaths, last, tmp_path, monkeypatch):
    """With a checkpoint of the very step at which nothing improves any more, and, where another phase follows, in that one."""
    monkeypatch.setattr(convergence, "CONVERGED", 0.99)  # as soon as there are losses to compare
    views = make_views(3, 2, 16)
    settings = QUICK.model_copy(update={"densify_until": 0.0, "checkpoint_seconds": 0.5})

    def training(folder, dies=None) -> Dying:
        trainer = Dying(fresh(views, static=True), views, phases, settings, budget=90, checkpoints=folder)
        trainer.dies = dies
        return trainer

    want = run(training(None))
    assert want.iteration == want.log.iterations == last and want.log.stopped.startswith("converged") == (len(phases) == 1)
    for dies in deaths:
        with pytest.raises(Killed):
            run(training(tmp_path, dies))
    again = run(training(tmp_path))
    assert continued(again) and again.iteration == last
    assert digests(again) == digests(want)
