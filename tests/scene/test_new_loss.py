"""A loss is a file of its own and a row in the table of terms: one that is made here is minimised on the CPU and in replayed steps, whose
buffers are made for whatever it asks for. What docs/extending.md shows is this one."""

from pathlib import Path

import pytest
import torch
from e4dgs.scene.losses.table import TERMS
from e4dgs.scene.losses.term import Term
from e4dgs.scene.model import Model
from e4dgs.scene.training import objective
from e4dgs.scene.training.replayed.buffers import Buffers, structure
from e4dgs.scene.training.replayed.objective import ReplayedObjective
from e4dgs.scene.training.replayed.padded_model import PaddedModel
from e4dgs.scene.views import floats
from replaying import TOTAL, Again, agree, begun, evaluated

SCENE = Path(objective.__file__).parents[1]
WEIGHT = 5.0


class Darkness(Term):
    """Renders should be dark, at edges most of all, and more so as training goes on."""

    name, every = "darkness", 3

    def due(self, model, now):
        return now.number >= 0.3 * self.run.total

    def inputs(self, model, now):
        return self.run.views.stored(now.frame, now.scale, "edges", now.window), self.run.progress(now.number)

    def value(self, rendered, inputs):
        edges, progress = inputs
        return WEIGHT * progress * (rendered.frame.color * (1 + floats(edges))[..., None]).mean()


@pytest.fixture
def with_darkness(monkeypatch):
    monkeypatch.setattr(objective, "TERMS", (*TERMS, Darkness))


def losses(trainer, step):
    """Of the usual step and of the replayed one."""
    return [float(evaluated(trainer, judge, step)["loss"]) for judge in (trainer.objective, trainer.replayed)]


@pytest.mark.parametrize("what", ["nodes", "lifetimes"])
def test_a_new_loss_is_minimised_in_usual_and_in_replayed_steps(what, with_darkness, monkeypatch):
    monkeypatch.setattr(Model, "in_view", lambda *given, **named: None)  # as on a GPU
    trainer = begun(what)
    trainer.replayed = ReplayedObjective(
        trainer.objective, lambda: trainer.learned.optimiser.parameters(), PaddedModel(), trainer._event, Again
    )
    agree(trainer, range(61, 100))
    graphs = trainer.replayed.graphs
    assert not trainer.log.events and len(graphs) >= 3
    captures, finds = graphs.captures, sum(known.finds for known in graphs._known.values())
    with_it = losses(trainer, 63)
    assert graphs.captures == captures and sum(known.finds for known in graphs._known.values()) == finds + 1, "a replay"
    monkeypatch.setattr(Darkness, "every", 1000)
    without, _ = losses(trainer, 63)
    assert with_it[0] == pytest.approx(with_it[1], rel=1e-4) and with_it[0] > without + 1e-5


def test_a_training_minimises_it(with_darkness, monkeypatch):
    trainer = begun("static")
    seen, value = [], Darkness.value

    def noted(term, rendered, inputs):
        seen.append(float(rendered.frame.color.detach().mean()))
        return value(term, rendered, inputs)

    monkeypatch.setattr(Darkness, "value", noted)
    trainer.run()
    assert len(seen) == len(range(60, TOTAL, 3)) and sum(seen[-10:]) < 0.7 * sum(seen[:10])


def test_only_its_file_and_the_table_name_a_term():
    for term in TERMS:
        own = SCENE.joinpath(*term.__module__.split(".")[2:]).with_suffix(".py")
        naming = {
            path for path in SCENE.rglob("*.py") if f"import {term.__name__}" in path.read_text() or f"{term.__name__}(" in path.read_text()
        }
        assert naming - {own} <= {SCENE / "losses" / "table.py"}, term
        assert own.is_file()


def test_buffers_hold_what_inputs_have_and_tell_kinds_apart():
    camera = begun("static").objective.run.camera(0, 1.0)
    first = (camera, 0.25, 3, None, (torch.arange(6, dtype=torch.uint8).view(2, 3), torch.ones(2, 2)), "name", True)
    second = (camera, 0.75, 4, None, (torch.zeros(2, 3, dtype=torch.uint8), torch.full((2, 2), 0.5)), "name", True)
    buffers = Buffers(first, torch.device("cpu"))
    assert structure(first) == structure(second)
    for given in (first, second):
        buffers.fill(given)
        found = buffers.inputs()
        assert torch.equal(found[0].K, camera.K) and torch.equal(found[0].cam_from_world, camera.cam_from_world)
        assert (found[0].width, found[0].height, found[0].near) == (camera.width, camera.height, camera.near)
        assert float(found[1]) == given[1] and int(found[2]) == given[2] and found[2].dtype == torch.int64
        assert torch.equal(found[4][0], given[4][0]) and torch.equal(found[4][1], given[4][1])
        assert found[3] is None and found[5:] == ("name", True)
    others = (
        (*first[:1], None, *first[2:]),
        (*first[:5], "other", True),
        (*first[:6], False),
        (*first[:4], (torch.ones(2, 2),) * 2, *first[5:]),
    )
    assert len({structure(one) for one in (first, *others)}) == 5
