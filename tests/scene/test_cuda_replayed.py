"""Steps replayed as CUDA graphs, on a GPU, against the same steps computed as usual."""

from collections import OrderedDict
from dataclasses import replace

import numpy as np
import pytest
import torch
from e4dgs.rasterizer.cuda import capacity
from e4dgs.scene.training.recipe import NODES
from e4dgs.scene.training.replayed import objective as replayed
from e4dgs.scene.training.schedule import Phase
from e4dgs.scene.training.trainer import Trainer
from e4dgs.stages.training.motions import make_nodes
from sliding_gaussians import SETTINGS, SIZE, fresh, make_views

TOTAL = 200
QUICK = SETTINGS.model_copy(update={"iterations": TOTAL, "densify_every": 40, "flow_every": 8, "affine": False})
PHASE = Phase("moving", TOTAL, move=True)
STEPS = (61, 62, 63, 64, 68, 72, 65, 76, 80, 66, 84, 88)  # plain ones, and ones with priors, depths and flow


def begun() -> Trainer:
    alpha = np.tile(np.linspace(0, 255, SIZE, dtype=np.uint8), (SIZE, 1))
    views = replace(make_views(), load_alpha=lambda i: alpha, device="cuda", _there=OrderedDict(), _there_bytes=0)
    model = fresh(views)
    model.field = make_nodes(model.gaussians.means.detach().numpy(), QUICK)
    trainer = Trainer(model.to("cuda"), views, [PHASE], QUICK, 200, recipe=NODES)
    trainer.objective.several = False  # as where each time has one camera, for which control nodes are
    return trainer


def judged(trainer: Trainer, judge, step: int) -> dict[str, torch.Tensor]:
    parameters = trainer.learned.optimiser.parameters()
    for p in parameters.values():
        p.grad = None
    frame = int(trainer.views.train[step % len(trainer.views.train)])
    found = judge(trainer.model, frame, step, PHASE, 1)
    found.backward()
    values = {"loss": found.loss.detach(), "image loss": found.image_loss, "color": found.color.detach()}
    return {k: v.clone() for k, v in (values | {name: p.grad for name, p in parameters.items() if p.grad is not None}).items()}


@pytest.mark.cuda
def test_loss_and_gradients_are_those_of_the_usual_step() -> None:
    trainer = begun()
    assert trainer.replayed is not None
    for step in STEPS:
        want, got = judged(trainer, trainer.objective, step), judged(trainer, trainer.replayed, step)
        assert got.keys() == want.keys()
        for name, value in want.items():
            assert (got[name] - value).norm() <= 1e-4 * value.norm() + 1e-9, (step, name)
    assert trainer.replayed.captures == 3 and not trainer.log.events


@pytest.mark.cuda
def test_a_whole_training_captures_again_after_every_change_of_the_model() -> None:
    trainer = begun()
    log = trainer.run()
    assert log.iterations == TOTAL and log.nonfinite_steps == 0 and trainer.replayed.captures > 3
    assert not any("not replayed" in event for event in log.events)
    assert log.loss[-1][1] < log.loss[0][1]


@pytest.mark.cuda
def test_a_graph_without_room_for_all_pairs_is_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replayed, "CHECK_EVERY", 16)
    trainer = begun()
    assert trainer.replayed is not None
    with monkeypatch.context() as small:
        small.setattr(capacity, "GRAPH_ROOM", 10)
        small.setattr(capacity, "GRAPH_SPARE", 0.0)
        for step in (61, 62):
            judged(trainer, trainer.replayed, step)
    plain = [step for step in range(63, 160) if step % 4 and step % 100]
    for step in plain[:20]:
        judged(trainer, trainer.replayed, step)
    assert trainer.replayed.captures == 2
    want, got = judged(trainer, trainer.objective, plain[20]), judged(trainer, trainer.replayed, plain[20])
    assert (got["color"] - want["color"]).abs().max() < 1e-4


@pytest.mark.cuda
def test_a_step_that_cannot_be_captured_is_computed_as_usual(monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = begun()
    of = trainer.objective.of

    def waiting(view):
        objective = of(view)
        terms = objective.motion_terms
        objective.motion_terms = lambda *given: terms(*given) * float(given[1].means.sum() * 0 + 1)
        return objective

    monkeypatch.setattr(trainer.objective, "of", waiting)
    for step in (61, 62, 63):
        want, got = judged(trainer, trainer.objective, step), judged(trainer, trainer.replayed, step)
        assert torch.allclose(got["loss"], want["loss"], rtol=1e-5)
    assert trainer.replayed.captures == 0 and any("not replayed" in event for event in trainer.log.events)
