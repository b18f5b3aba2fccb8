"""Steps that are captured once and then replayed for other frames, steps and numbers of primitives, with something on the CPU in place of
CUDA graphs that computes again what was captured."""

import pytest
import torch
from e4dgs.scene.model import Model
from e4dgs.scene.training.control.splits import split
from e4dgs.scene.training.replayed import padded_set
from e4dgs.scene.training.replayed.objective import ReplayedObjective
from e4dgs.scene.training.replayed.padded_model import PaddedModel
from e4dgs.scene.training.replayed.responsibility import ReplayedResponsibility
from replaying import KINDS, PHASE, Again, agree, agree_in_other_numbers, agree_on_responsibility, begun, evaluated


@pytest.fixture(autouse=True)
def as_on_a_gpu(monkeypatch):
    monkeypatch.setattr(Model, "in_view", lambda *given, **named: None)


def begin(what):
    trainer = begun(what)
    memory, parameters = PaddedModel(), lambda: trainer.learned.optimiser.parameters()
    trainer.replayed = ReplayedObjective(trainer.objective, parameters, memory, trainer._event, Again)
    trainer.density._measure = ReplayedResponsibility(trainer.views, memory, trainer._event, Again)
    return trainer


@pytest.mark.parametrize("what", KINDS)
def test_other_frames_steps_and_numbers_of_primitives_give_what_the_usual_step_gives(what):
    trainer = begin(what)
    assert agree_in_other_numbers(trainer) == len(trainer.replayed.graphs) >= 3


@pytest.mark.parametrize("what", KINDS)
def test_responsibility_is_measured_as_usual(what):
    agree_on_responsibility(begin(what))


def test_steps_move_what_the_graphs_read():
    trainer = begin("lifetimes")
    agree(trainer, range(61, 100))
    for step in range(100, 110):
        found = trainer.replayed(trainer.model, int(trainer.views.train[step % 5]), step, PHASE, 1)
        found.backward()
        trainer.learned.optimiser.step(0.5, rows=found.rows)
    agree(trainer, range(110, 120))
    assert trainer.replayed.graphs.memory._sets[0].padded.means.data_ptr() == trainer.model.gaussians.means.data_ptr()


def test_links_are_searched_again_for_replays_too():
    trainer = begin("nodes")
    agree(trainer, range(61, 101))
    graphs = trainer.replayed.graphs
    captures, replays = graphs.captures, sum(known.finds for known in graphs._known.values())
    with torch.no_grad():
        trainer.model.gaussians.means.mul_(-1)
    got, want = evaluated(trainer, trainer.replayed, 100), evaluated(trainer, trainer.objective, 100)
    assert (graphs.captures, sum(known.finds for known in graphs._known.values())) == (captures, replays + 1)
    assert all((got[name] - value).norm() <= 1e-4 * value.norm() + 1e-7 for name, value in want.items())


def test_more_than_there_is_room_for_is_captured_again(monkeypatch):
    monkeypatch.setattr(padded_set, "LEAST_SPARE", 4)
    monkeypatch.setattr(padded_set, "SPARE", 1.0)
    trainer = begin("nodes")
    agree(trainer, range(61, 80))
    captures = trainer.replayed.graphs.captures
    gaussians = trainer.model.gaussians
    trainer.learned.replace(*split(gaussians, torch.arange(3)), 100)
    agree(trainer, range(61, 80))
    assert trainer.replayed.graphs.captures == captures, "3 more leave one row that holds nothing"
    trainer.learned.replace(*split(trainer.model.gaussians, torch.arange(1)), 101)
    agree(trainer, range(61, 80))
    assert trainer.replayed.graphs.captures == 2 * captures


def test_gaussians_that_leave_the_motion_are_captured_again_only_where_none_had():
    trainer = begin("nodes")
    agree(trainer, range(61, 80))
    captures = trainer.replayed.graphs.captures
    trainer.model.gaussians.dynamic[:7] = False
    agree(trainer, range(61, 80))
    assert trainer.replayed.graphs.captures == 2 * captures
    trainer.model.gaussians.dynamic[7:14] = False
    agree(trainer, range(61, 80))
    assert trainer.replayed.graphs.captures == 2 * captures


def test_a_step_that_cannot_be_captured_is_computed_as_usual():
    trainer = begin("nodes")

    def refuses(function, device, pool):
        raise RuntimeError("operation not permitted when stream is capturing\nand more")

    trainer.replayed.graphs._record = refuses
    agree(trainer, range(61, 70))
    assert trainer.replayed.graphs.captures == 0 and trainer.log.events == [
        "steps are not replayed as CUDA graphs: operation not permitted when stream is capturing"
    ]
