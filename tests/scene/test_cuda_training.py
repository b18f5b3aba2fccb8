"""Training with everything on a CUDA device. There is none here: `pretending_cuda` makes tensors carry the mark of one, refuses what a GPU
would refuse, and runs the CUDA kernels in the emulator. The scene is that of sliding_gaussians.py."""

from collections import OrderedDict
from dataclasses import replace

import numpy as np
import pytest
import torch
from e4dgs.scene.motion.free import FreeMotion
from e4dgs.scene.primitives import ConvexSet
from e4dgs.scene.training.guard import MOST_IN_A_ROW, TrainingDiverged
from e4dgs.scene.training.recipe import PLANES
from e4dgs.scene.training.schedule import Phase
from e4dgs.scene.training.steps.late import LATEST
from e4dgs.scene.training.trainer import Trainer
from e4dgs.stages.training.motions import make_nodes
from pretend_cuda import pretending_cuda
from simt import needs_compiler
from sliding_gaussians import SETTINGS, SIZE, fresh, make_views

pytestmark = needs_compiler

PHASES = [Phase("still", 6, move=False), Phase("moving", 24, move=True)]
QUICK = SETTINGS.model_copy(update={"iterations": 30, "densify_every": 10, "flow_every": 4})


@pytest.fixture(scope="module")
def views():
    return make_views()


def there(views):
    return replace(views, device="cuda", _there=OrderedDict(), _there_bytes=0)


def measured(i):
    """A flow of one pixel to the right, everywhere, on the CPU as the stages hand it in."""
    return torch.tensor([1.0, 0.0]).expand(SIZE // 2, SIZE // 2, 2).clone(), torch.ones(SIZE // 2, SIZE // 2)


def trained(model, views, phases=PHASES, **options):
    torch.manual_seed(0)
    trainer = Trainer(model, views, phases, QUICK, 90, measured_flow=measured, **options)
    return trainer.run(), trainer


def test_planes_train_as_on_the_cpu(views, tmp_path):
    """Warm-up, motion, flow terms, priors, density control, freezing and checkpoints; the same numbers to rounding at first."""
    on_cpu = fresh(views)
    want, _ = trained(on_cpu, views)
    with pretending_cuda():
        model = fresh(views).to("cuda")
        got, _ = trained(model, there(views), checkpoints=tmp_path)
        assert model.device.type == "cuda" and model.gaussians.dynamic.device.type == "cuda"
        arrays = model.to_arrays()
    assert got.iterations == want.iterations == 30 and got.nonfinite_steps == 0
    assert np.allclose([row[1] for row in got.loss], [row[1] for row in want.loss], rtol=5e-3)
    assert [row[1:] for row in got.primitives] == [row[1:] for row in want.primitives]
    assert all(isinstance(array, np.ndarray) and np.isfinite(array).all() for array in arrays.values())


def test_a_checkpoint_goes_on_on_the_device(views, tmp_path):
    with pretending_cuda():
        trained(fresh(views).to("cuda"), there(views), phases=[PHASES[0], replace(PHASES[1], iterations=14)], checkpoints=tmp_path)
        model = fresh(views).to("cuda")
        log, trainer = trained(model, there(views), checkpoints=tmp_path)
        assert any(event.startswith("continued from the checkpoint") for event in log.events)
        assert model.device.type == "cuda" and all(p.is_cuda for p in trainer.learned.optimiser.parameters().values())


def test_nodes_train_as_on_the_cpu(views):
    """With the capture's alpha, as captures for nodes have it."""
    views = replace(views, load_alpha=lambda i: np.tile(np.linspace(0, 255, SIZE, dtype=np.uint8), (SIZE, 1)))

    def begun():
        model = fresh(views)
        model.field = make_nodes(model.gaussians.means.detach().numpy(), QUICK)
        return model

    phases = [Phase("moving", 30, move=True)]
    want, _ = trained(begun(), views, phases=phases)
    with pretending_cuda():
        got, _ = trained(begun().to("cuda"), there(views), phases=phases)
    assert got.nonfinite_steps == 0
    assert np.allclose([row[1] for row in got.loss], [row[1] for row in want.loss], rtol=5e-3)


def test_primitives_of_their_own_life_train(views):
    with pretending_cuda():
        model = fresh(views)
        model.field = FreeMotion(4)
        model.gaussians.live(1.5, 2.0)
        before = model.gaussians.velocities.detach().clone()
        log, trainer = trained(model.to("cuda"), there(views), phases=[Phase("moving", 30, move=True)])
    assert log.iterations == 30 and log.nonfinite_steps == 0
    assert float(trainer.model.gaussians.velocities.detach().abs().max()) > float(before.abs().max())


def begun(views, model=None, **options):
    """A trainer of few terms on the device, and what takes its steps with these numbers."""
    model = (model or fresh(views)).to("cuda")
    quiet = QUICK.model_copy(update={"flow_every": 1000, "densify_every": 1000, "tv": 0.0, "rigid": 0.0, "inertia": 0.0})
    trainer = Trainer(model, there(views), [Phase("moving", 100, move=True)], quiet, 90, **options)

    def take(*steps):
        for step in steps:
            trainer.iteration = step
            trainer._step(trainer.phases[0], step)

    return trainer, take


def poison(trainer, monkeypatch):
    monkeypatch.setattr(trainer.views, "target", lambda i, *size: torch.full((SIZE, SIZE, 3), torch.inf, device="cuda"))


def learned(trainer):
    """Bits of parameters and moments, without step counts."""
    state = trainer.learned.optimiser.parameters() | trainer.learned.optimiser.state()
    return {name: t.detach().cpu().clone() for name, t in state.items() if not name.endswith("/step")}


def test_a_step_that_is_not_finite_is_as_if_it_had_not_been(views, monkeypatch):
    """The device leaves it out at once; the host hears of it later, and then corrects what it has counted."""
    with pretending_cuda():
        model = fresh(views)
        model.convexes = ConvexSet.from_points(np.random.default_rng(0).normal(size=(5, 6, 3)), np.full((5, 3), 0.5), 0)
        trainer, take = begun(views, model, recipe=replace(PLANES, largest_convex=0.01))
        take(1, 2, 3)
        before, losses = learned(trainer), trainer._smoothed()
        with monkeypatch.context() as patch:
            poison(trainer, patch)
            take(4)
        assert trainer.log.events == [] and trainer.guard.count == 0, "it is not known yet"
        assert all(torch.equal(now, before[name]) for name, now in learned(trainer).items())
        take(5, 6)
        assert trainer.log.events == ["step 4: not finite, rolled back"] and trainer.guard.count == 1
        assert any(not torch.equal(now, before[name]) for name, now in learned(trainer).items())
        assert np.isfinite(trainer._smoothed()) and trainer._smoothed() != losses
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

    def poisoned(i, scale=1.0, window=None):
        calls.append(i)
        return original(i, scale, window) * (float("inf") if len(calls) == 20 else 1.0)

    with pretending_cuda():
        mine = there(views)
        original = mine.target
        monkeypatch.setattr(mine, "target", poisoned)
        log, _ = trained(fresh(views).to("cuda"), mine, checkpoints=tmp_path)
    bad = [event for event in log.events if event.endswith("not finite, rolled back")]
    assert len(bad) == log.nonfinite_steps >= 1 and all(np.isfinite(loss) for _, loss in log.loss)


def test_training_that_stays_not_finite_stops(views, monkeypatch):
    with pretending_cuda():
        trainer, take = begun(views)
        poison(trainer, monkeypatch)
        with pytest.raises(TrainingDiverged, match=rf"step {MOST_IN_A_ROW}, frame \d+: (gradients of gaussians\.|the loss)"):
            take(*range(1, MOST_IN_A_ROW + 2))
    assert trainer.guard.count == MOST_IN_A_ROW


def test_an_answer_is_waited_for_before_it_is_old(views, monkeypatch):
    with pretending_cuda() as pretending:
        trainer, take = begun(views)
        poison(trainer, monkeypatch)
        monkeypatch.setattr(torch.cuda.Event, "query", lambda event: False)
        take(*range(1, LATEST + 1))
        assert trainer.guard.count == 0 and "synchronize" not in [sync.what for sync in pretending.syncs]
        take(LATEST + 1)
        assert trainer.guard.count == 1 and [sync.what for sync in pretending.syncs].count("synchronize") == 1
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
