"""Steps on a CUDA device, which judges them by itself: what is not finite leaves no trace, and the host hears of it later. There is no such
device here: see test_cuda_training.py."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from e4dgs.scene.motion.phases import Phase
from e4dgs.scene.motion.planes.field import DeformationField
from e4dgs.scene.primitives import ConvexSet
from e4dgs.scene.training.guard import MOST_IN_A_ROW, TrainingDiverged
from e4dgs.scene.training.steps.deferred import LATEST
from e4dgs.scene.training.trainer import Trainer
from pretend_cuda import pretending_cuda
from simt import needs_compiler
from sliding_gaussians import SETTINGS, fresh, make_views, there

pytestmark = needs_compiler

QUICK = SETTINGS.model_copy(update={"iterations": 30, "densify_every": 10, "flow_every": 4})


@pytest.fixture(scope="module")
def views():
    return make_views()


def begun(views, model=None, **options):
    """A trainer of few terms on the device, and what takes its steps with these numbers."""
    model = (model or fresh(views)).to("cuda")
    quiet = QUICK.model_copy(
        update={"flow_every": 1000, "densify_every": 1000, "tv_weight": 0.0, "rigid_weight": 0.0, "inertia_weight": 0.0}
    )
    trainer = Trainer(model, there(views), [Phase("moving", 100, move=True)], quiet, 90, **options)

    def take(*steps):
        for step in steps:
            trainer.iteration = step
            trainer._step(trainer.phases[0], step)

    return trainer, take


def poison(trainer, monkeypatch):
    appearance = trainer.objective.terms[0]
    value = appearance.value
    monkeypatch.setattr(appearance, "value", lambda *given: value(*given) * torch.inf)


def learned(trainer):
    """Bits of parameters and moments, without step counts."""
    state = trainer.learned.optimiser.parameters() | trainer.learned.optimiser.state()
    return {name: t.detach().cpu().clone() for name, t in state.items() if not name.endswith("/step")}


def settled(trainer):
    """The smoothed loss of all steps so far."""
    trainer.steps.settle()
    return trainer.loss.value()


def test_a_step_that_is_not_finite_is_as_if_it_had_not_been(views, monkeypatch):
    """The device leaves it out at once; the host hears of it later, and then corrects what it has counted."""
    with pretending_cuda():
        model = fresh(views)
        model.convexes = ConvexSet.from_points(np.random.default_rng(0).normal(size=(5, 6, 3)), np.full((5, 3), 0.5), 0)
        trainer, take = begun(views, model, recipe=replace(DeformationField.recipe, largest_convex=0.01))
        take(1, 2, 3)
        before, losses = learned(trainer), settled(trainer)
        with monkeypatch.context() as patch:
            poison(trainer, patch)
            take(4)
        assert trainer.log.events == [] and trainer.guard.count == 0, "it is not known yet"
        assert all(torch.equal(now, before[name]) for name, now in learned(trainer).items())
        take(5, 6)
        assert trainer.log.events == ["step 4: not finite, rolled back"] and trainer.guard.count == 1
        assert any(not torch.equal(now, before[name]) for name, now in learned(trainer).items())
        assert np.isfinite(settled(trainer)) and settled(trainer) != losses
        steps = {name: int(t) for name, t in trainer.learned.optimiser.state().items() if name.endswith("/step")}
        assert set(steps.values()) == {5}, steps


@pytest.mark.cuda
def test_on_a_gpu_a_step_that_is_not_finite_is_as_if_it_had_not_been(views, monkeypatch):
    trainer, take = begun(views)
    take(1, 2, 3)
    before = learned(trainer)
    with monkeypatch.context() as patch:
        poison(trainer, patch)
        take(4)
    assert all(torch.equal(now, before[name]) for name, now in learned(trainer).items())
    take(*range(5, 20))
    trainer.steps.settle()
    assert trainer.log.events == ["step 4: not finite, rolled back"] and trainer.guard.count == 1
    steps = [int(t) for name, t in trainer.learned.optimiser.state().items() if name.endswith("/step")]
    assert set(steps) == {18}


def test_a_bad_step_of_a_whole_training_is_counted(views, monkeypatch, tmp_path):
    calls = []

    def poisoned(*given):
        calls.append(given)
        return value(*given) * (torch.inf if len(calls) == 20 else 1.0)

    with pretending_cuda():
        phases = [Phase("still", 6, move=False), Phase("moving", 24, move=True)]
        trainer = Trainer(fresh(views).to("cuda"), there(views), phases, QUICK, 90, checkpoints=tmp_path)
        appearance = trainer.objective.terms[0]
        value = appearance.value
        monkeypatch.setattr(appearance, "value", poisoned)
        log = trainer.run()
    bad = [event for event in log.events if event.endswith("not finite, rolled back")]
    assert len(bad) == log.nonfinite_steps >= 1 and all(np.isfinite(loss) for _, loss in log.loss)


def test_training_that_stays_not_finite_stops(views, monkeypatch):
    with pretending_cuda():
        trainer, take = begun(views)
        poison(trainer, monkeypatch)
        with pytest.raises(TrainingDiverged, match=rf"step {MOST_IN_A_ROW}, frame \d+: (gradients of gaussians\.|the loss)"):
            take(*range(1, MOST_IN_A_ROW + 2))
    assert trainer.guard.count == MOST_IN_A_ROW


def waits_for_answers(pretending):
    return sum(sync.what == "synchronize" and "training/steps" in sync.where for sync in pretending.syncs)


def test_an_answer_is_waited_for_before_it_is_old(views, monkeypatch):
    with pretending_cuda() as pretending:
        trainer, take = begun(views)
        poison(trainer, monkeypatch)
        monkeypatch.setattr(torch.cuda.Event, "query", lambda event: False)
        take(*range(1, LATEST + 1))
        assert trainer.guard.count == 0 and waits_for_answers(pretending) == 0
        take(LATEST + 1)
        assert trainer.guard.count == 1 and waits_for_answers(pretending) == 1
        trainer.learned.before_change()
        assert trainer.guard.count == LATEST + 1


def test_a_step_waits_for_the_device_a_few_times_only(views):
    """Each wait lets the GPU run dry. Of a usual step: what moves and is in view, of each kind; the number of pairs."""
    with pretending_cuda() as pretending:
        _, take = begun(views)
        take(*range(1, 7))  # not the first one, which is logged
        pretending.syncs.clear()
        pretending.kernels.clear()
        take(7)
        waits = [f"{sync.what} {sync.where}" for sync in pretending.syncs if sync.what not in ("upload",)]
        assert len(waits) <= 3, waits
        assert not any("training/steps" in wait or "optimiser" in wait or "guard" in wait for wait in waits)
        assert [name for name in pretending.kernels if "adam" in name or "check" in name] == ["check_gradients", "adam_rows"]
