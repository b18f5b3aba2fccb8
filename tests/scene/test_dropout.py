"""Gaussians that training steps of rigs leave out at random."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from e4dgs.scene.motion.kinds import motion_class
from e4dgs.scene.motion.lifetimes.lifetimes import Lifetimes
from e4dgs.scene.motion.phases import Phase
from e4dgs.scene.motion.start import Start
from e4dgs.scene.training.objective import DROPOUT_GROWS
from e4dgs.scene.training.optimiser import ALL_ROWS
from e4dgs.scene.training.steps.dropout import MOST_OPAQUE, keeps, thinned
from e4dgs.scene.training.trainer import Trainer
from sliding_gaussians import SETTINGS, fresh, make_views

SHARE = 0.2
PHASE = Phase("refinement", 100, move=False)


def trainer_of(tmp_path, cameras=4, dropout=SHARE):
    views = make_views(cameras=cameras, times=3, size=32)
    model = fresh(views, static=True)
    model.gaussians.dynamic = torch.arange(len(model.gaussians)) % 4 == 0
    return Trainer(model, views, [PHASE], SETTINGS.model_copy(update={"dropout": dropout}), 80, tmp_path, grow=False)


def test_each_step_leaves_out_others_but_none_that_move():
    dynamic = torch.arange(40_000) < 10_000
    first, again, other, seeded = (keeps(dynamic, SHARE, *given) for given in ((0, 7), (0, 7), (0, 8), (1, 7)))
    assert torch.equal(first, again) and first[:10_000].all()
    for keep in (first, other, seeded):
        assert float(keep[10_000:].float().mean()) == pytest.approx(1 - SHARE, abs=4 * math.sqrt(SHARE * (1 - SHARE) / 30_000))
    both = (~first & ~other)[10_000:].float().mean()
    assert float(both) == pytest.approx(SHARE**2, abs=0.006), "what one step leaves out says nothing of the next"
    assert keeps(dynamic, 0.0, 0, 0).all()


def test_the_others_are_more_opaque_so_that_the_mean_stays(tmp_path):
    model = trainer_of(tmp_path).model
    whole, _ = model.at(0.5, None, False)
    dynamic = model.gaussians.dynamic
    total, steps = torch.zeros(len(dynamic)), 4000
    for step in range(steps):
        keep = keeps(dynamic, SHARE, 0, step)
        shown = thinned(whole, dynamic, SHARE, keep).opacities
        assert torch.equal(shown[dynamic], whole.opacities[dynamic]) and not shown[~keep].any()
        total += shown
    assert float((total / steps / whole.opacities - 1).detach().abs().max()) < 6 * math.sqrt(SHARE / (1 - SHARE) / steps)
    opaque = replace(whole, opacities=torch.full_like(whole.opacities, 0.99))
    assert float(thinned(opaque, dynamic, SHARE).opacities[~dynamic].max()) == pytest.approx(MOST_OPAQUE)


def test_the_share_grows_until_losses_are_compared(tmp_path):
    trainer = trainer_of(tmp_path)
    shares = [trainer.objective.left_out(step) for step in (0, 30, 75, 99)]
    assert shares == pytest.approx([0, SHARE * 0.3 / DROPOUT_GROWS, SHARE, SHARE])
    assert trainer.density.grow_until >= DROPOUT_GROWS


def test_one_camera_or_a_share_of_zero_leaves_out_none(tmp_path):
    assert (
        trainer_of(tmp_path / "a", cameras=1).objective.left_out(99) == trainer_of(tmp_path / "b", dropout=0.0).objective.left_out(99) == 0
    )


def test_where_nothing_moves_all_can_be_left_out():
    points = np.random.default_rng(0).normal(size=(40, 3))
    start = Start(points, np.full((40, 3), 0.5), np.zeros(40, bool), None, 0, 1.0)
    _, gaussians = motion_class("static").start(start, make_views(cameras=4, times=2, size=32), SETTINGS)
    assert not gaussians.dynamic.any()


def test_what_becomes_visible_because_others_are_left_out_is_in_view(tmp_path):
    trainer = trainer_of(tmp_path, dropout=0.5)
    model, last = trainer.model, PHASE.iterations - 1
    model.gaussians.dynamic[:] = False
    with torch.no_grad():
        model.gaussians.opacity_logits.fill_(math.log(0.003 / 0.997))  # below 1/255, and above it once it is divided by 0.5
    model.motion = Lifetimes(3)
    evaluated = trainer.objective(model, 0, last, PHASE, 0)
    assert len(evaluated.rows.index) and float(evaluated.color.detach().amax()) > 0.003


def test_rows_in_view_get_the_gradients_that_all_rows_would(tmp_path, monkeypatch):
    """Whether what is left out is not computed with, or is transparent. The penalty on opacity holds for those, too."""
    found = []
    for computes_with_all in (False, True):
        trainer = trainer_of(tmp_path / str(computes_with_all))
        model, frame = trainer.model, int(trainer.views.train[0])
        if computes_with_all:
            monkeypatch.setattr(type(model), "in_view", lambda *given: None)
        evaluated = trainer.objective(model, frame, 99, PHASE, 0)
        evaluated.backward()
        gradients = {}
        for name, p in model.named_parameters().items():
            if name.startswith("gaussians.") and p.numel():
                grad, index = evaluated.rows.gradient(name, p)
                gradients[name] = torch.zeros_like(p)
                if grad is not None:
                    gradients[name] = grad if index is None else gradients[name].index_copy(0, index, grad)
        assert (evaluated.rows is ALL_ROWS) == computes_with_all
        found.append((evaluated.color.detach(), float(evaluated.loss.detach()), gradients))
    (color, loss, some), (same_color, same_loss, everything) = found
    assert torch.equal(color, same_color) and loss == pytest.approx(same_loss, rel=1e-6)
    keep = keeps(model.gaussians.dynamic, SHARE, 0, 99)
    assert not keep.all() and not everything["gaussians.means"][~keep].any() and everything["gaussians.means"].any()
    for name, gradient in some.items():
        torch.testing.assert_close(gradient, everything[name], rtol=1e-5, atol=1e-9)
