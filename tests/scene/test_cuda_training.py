"""Training with everything on a CUDA device. There is none here: `pretending_cuda` makes tensors carry the mark of one, refuses what a GPU
would refuse, and runs the CUDA kernels in the emulator. The scene is that of sliding_gaussians.py."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from e4dgs.scene.losses.term import Measured
from e4dgs.scene.motion.lifetimes.lifetime import set_lifetime
from e4dgs.scene.motion.lifetimes.lifetimes import Lifetimes
from e4dgs.scene.motion.nodes.control_nodes import ControlNodes
from e4dgs.scene.motion.phases import Phase
from e4dgs.scene.training.trainer import Trainer
from pretend_cuda import pretending_cuda
from simt import needs_compiler
from sliding_gaussians import SETTINGS, SIZE, fresh, make_views, there

pytestmark = needs_compiler

PHASES = [Phase("still", 6, move=False), Phase("moving", 24, move=True)]
QUICK = SETTINGS.model_copy(update={"iterations": 30, "densify_every": 10, "flow_every": 4})


@pytest.fixture(scope="module")
def views():
    return make_views()


def measured(i):
    """A flow of one pixel to the right, everywhere, on the CPU as the stages hand it in."""
    return torch.tensor([1.0, 0.0]).expand(SIZE // 2, SIZE // 2, 2).clone(), torch.ones(SIZE // 2, SIZE // 2)


def trained(model, views, phases=PHASES, **options):
    torch.manual_seed(0)
    trainer = Trainer(model, views, phases, QUICK, 90, measured=Measured(measured), **options)
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
        model.motion = ControlNodes.over(model.gaussians.means.detach().numpy(), QUICK.seed)
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
        model.motion = Lifetimes(4)
        set_lifetime(model.gaussians, 1.5, 2.0)
        before = model.gaussians.velocities.detach().clone()
        log, trainer = trained(model.to("cuda"), there(views), phases=[Phase("moving", 30, move=True)])
    assert log.iterations == 30 and log.nonfinite_steps == 0
    assert float(trainer.model.gaussians.velocities.detach().abs().max()) > float(before.abs().max())
