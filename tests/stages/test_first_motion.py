"""Control nodes look for the motion on very small images before `coarse` proper, and not again where that has been interrupted."""

from types import SimpleNamespace

import pytest
import torch
from e4dgs.pipeline import Progress
from e4dgs.scene.motion.kinds import KINDS
from e4dgs.scene.motion.nodes.control_nodes import ControlNodes
from e4dgs.scene.motion.nodes.schedule import first_motion_steps, node_phases
from e4dgs.scene.motion.phases import Phase
from e4dgs.scene.training.checkpoint import model_of
from e4dgs.stages.coarse import first_motion
from e4dgs.stages.coarse.settings import CoarseSettings
from e4dgs.stages.shared.train import train
from sliding_gaussians import fresh, wandering_views

STEPS = 60


@pytest.fixture
def start(tmp_path):
    """Views, a model of nodes at rest, and what a stage is given."""
    views, settings = wandering_views(12), CoarseSettings(affine=False)
    model = fresh(views, static=True)
    model.gaussians.dynamic[:] = True
    model.motion = ControlNodes.over(model.gaussians.means.detach().numpy(), settings.seed)
    return views, model, settings, SimpleNamespace(checkpoints=tmp_path, progress=Progress, log=lambda line: None)


def test_nodes_move_and_nothing_holds_them_rigid(start, monkeypatch):
    views, model, settings, ctx = start
    given = {}

    def recorded(ctx, name, model, views, phases, settings, **options):
        given.update(settings=settings, steps=sum(phase.iterations for phase in phases), scales={phase.scale for phase in phases})
        return train(ctx, name, model, views, phases, settings, **options)

    monkeypatch.setattr(first_motion, "train", recorded)
    before = model.motion.at(0.1).shifts.detach().clone()
    first_motion.find_first_motion(ctx, model, views, settings, STEPS, small=True)
    assert given["steps"] == first_motion_steps("two-stage", STEPS) and given["scales"] == {0.5}
    assert given["settings"].rigid_weight == 0 and settings.rigid_weight > 0
    assert float((model.motion.at(0.1).shifts.detach() - before).abs().max()) > 1e-4


def test_its_checkpoint_is_its_own(start):
    views, model, settings, ctx = start
    lines: list[str] = []
    ctx.log, often = lines.append, settings.model_copy(update={"checkpoint_seconds": 1e-9})
    first_motion.find_first_motion(ctx, model, views, often, STEPS, small=True)
    assert model_of(ctx.checkpoints) is not None  # the viewer has something to show
    first_motion.find_first_motion(ctx, model, views, settings, STEPS, small=True)
    assert sum("continued from the checkpoint" in line for line in lines) == 1
    log = train(ctx, "coarse", model, views, node_phases(STEPS, 1.0), settings, budget=90)
    assert log.iterations == STEPS and sum("continued from the checkpoint" in line for line in lines) == 1


def test_a_training_that_goes_on_from_its_checkpoint_does_not_begin_again(start):
    views, model, settings, ctx = start
    train(ctx, "coarse", model, views, node_phases(STEPS, 1.0), settings.model_copy(update={"checkpoint_seconds": 1e-9}), budget=90)
    assert any(ctx.checkpoints.iterdir())
    before = model.gaussians.means.detach().clone()
    first_motion.find_first_motion(ctx, model, views, settings, STEPS, small=True)
    assert torch.equal(model.gaussians.means.detach(), before)


def test_the_time_left_weighs_steps_by_the_size_of_their_images(start):
    views, model, settings, ctx = start
    bars = []
    ctx.progress = lambda total, label: bars.append(Progress(total, label)) or bars[-1]
    train(ctx, "coarse", model, views, [Phase("small", 2, scale=0.5), Phase("full", 2)], settings, budget=500)
    (bar,) = bars
    kind, megapixels = KINDS["nodes"], views.width * views.height / 1e6
    extra = 2 * kind.megapixel_seconds * megapixels * 0.75  # of two steps on the full image over two on half the size
    assert bar._work(4) - bar._work(2) == pytest.approx(bar._work(2) + extra)
