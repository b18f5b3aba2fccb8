"""Steps replayed as CUDA graphs, on a GPU, against the same steps computed as usual."""

import pytest
import torch
from e4dgs.rasterizer.cuda import capacity
from e4dgs.scene.losses.opacity import Opacity
from e4dgs.scene.training.replayed import graphs
from replaying import KINDS, TOTAL, agree, agree_in_other_numbers, agree_on_responsibility, begun, evaluated


@pytest.mark.cuda
@pytest.mark.parametrize("what", KINDS)
def test_loss_and_gradients_are_those_of_the_usual_step(what: str) -> None:
    assert agree_in_other_numbers(begun(what, "cuda")) >= 3


@pytest.mark.cuda
@pytest.mark.parametrize("what", KINDS)
def test_responsibility_is_measured_as_usual(what: str) -> None:
    agree_on_responsibility(begun(what, "cuda"))


@pytest.mark.cuda
@pytest.mark.parametrize("what", KINDS)
def test_a_whole_training(what: str) -> None:
    trainer = begun(what, "cuda")
    log = trainer.run()
    assert log.iterations == TOTAL and log.nonfinite_steps == 0 and trainer.replayed.graphs.captures >= 3
    assert not any("not replayed" in event for event in log.events)
    assert log.loss[-1][1] < log.loss[0][1]


@pytest.mark.cuda
def test_a_graph_without_room_for_all_pairs_is_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(graphs, "CHECK_EVERY", 16)
    trainer = begun("nodes", "cuda")
    plain = [step for step in range(61, 160) if step % 4 and step % 100]
    with monkeypatch.context() as small:
        small.setattr(capacity, "GRAPH_ROOM", 10)
        small.setattr(capacity, "GRAPH_SPARE", 0.0)
        for step in plain[:2]:
            evaluated(trainer, trainer.replayed, step)
    for step in plain[2:22]:
        evaluated(trainer, trainer.replayed, step)
    assert trainer.replayed.graphs.captures == 2
    want, got = evaluated(trainer, trainer.objective, plain[22]), evaluated(trainer, trainer.replayed, plain[22])
    assert (got["color"] - want["color"]).abs().max() < 1e-4


@pytest.mark.cuda
def test_a_step_that_waits_for_the_device_is_computed_as_usual(monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = begun("nodes", "cuda")
    value = Opacity.value

    def waiting(*given):
        found = value(*given)
        return found * (1 + 0 * float(found.detach()))

    monkeypatch.setattr(Opacity, "value", waiting)
    agree(trainer, [61, 62, 63])
    assert trainer.replayed.graphs.captures == 0 and any("not replayed" in event for event in trainer.log.events)
    assert bool(torch.isfinite(trainer.model.gaussians.means).all())
