"""The loss that holds what moves at a depth, and when it has none."""

from dataclasses import replace

import pytest
import torch
from e4dgs.scene.losses.held_depth import LARGEST, HeldDepth, held_depth_difference
from e4dgs.scene.losses.moving_depth import MovingDepth
from e4dgs.scene.losses.term import Measured, Now
from replaying import begun


def held(inverse, confidence=1.0):
    inverse = torch.as_tensor(inverse, dtype=torch.float64)
    return torch.stack([inverse, torch.full_like(inverse, confidence)])


def test_it_is_the_mean_difference_of_inverse_depths_where_something_is_held():
    depth = torch.tensor([[4.0, 4.0, 2.0, 4.0]], dtype=torch.float64)
    alpha = torch.tensor([[1.0, 1.0, 1.0, 0.2]], dtype=torch.float64)  # the last pixel shows no surface
    target = held([[0.2, 0.0, 0.5, 0.9]])
    unit = 4.0
    assert float(held_depth_difference(depth, alpha, target, unit)) == pytest.approx(unit * 0.05 / 4)
    assert float(held_depth_difference(depth, alpha, held(target[0], 0.5), unit)) == pytest.approx(unit * 0.05 / 8)


def test_it_pulls_towards_the_depth_and_not_beyond_the_largest_difference():
    depth = torch.tensor([[5.0, 3.0, 0.5]], dtype=torch.float64, requires_grad=True)
    loss = held_depth_difference(depth, torch.ones(1, 3, dtype=torch.float64), held([[0.25] * 3]), 1.0)
    loss.backward()
    assert depth.grad[0, 0] > 0 > depth.grad[0, 1] and depth.grad[0, 2] == 0
    assert LARGEST < 1 / 0.5 - 0.25


def test_weights_of_pixels_scale_gradients_alone():
    grads, losses = [], []
    for weight in (None, torch.tensor([[3.0, 0.0]], dtype=torch.float64)):
        depth = torch.tensor([[5.0, 5.0]], dtype=torch.float64, requires_grad=True)
        loss = held_depth_difference(depth, torch.ones(1, 2, dtype=torch.float64), held([[0.25, 0.25]]), 1.0, weight)
        loss.backward()
        grads, losses = [*grads, depth.grad], [*losses, loss.item()]
    assert losses[0] == losses[1] and torch.allclose(grads[1], grads[0] * torch.tensor([[3.0, 0.0]]))


def test_the_gradient_is_that_of_the_loss():
    draw = torch.Generator().manual_seed(0)
    depth = (3 + 3 * torch.rand(4, 5, generator=draw, dtype=torch.float64)).requires_grad_()
    alpha = (0.6 + 0.4 * torch.rand(4, 5, generator=draw, dtype=torch.float64)).requires_grad_()
    target = held(0.2 + 0.05 * torch.rand(4, 5, generator=draw, dtype=torch.float64))
    assert torch.autograd.gradcheck(lambda d, a: held_depth_difference(d, a, target, 1.0), (depth, alpha), eps=1e-6, atol=1e-8)


def test_maps_are_resized():
    maps = HeldDepth({3: torch.tensor([[[0.25, 0.5]], [[1.0, 0.5]]])}, 1.0)
    assert maps.of(4, 1, 2) is None
    found = maps.of(3, 2, 4)
    assert found.shape == (2, 2, 4) and torch.equal(found[0], torch.tensor([[0.25, 0.25, 0.5, 0.5]] * 2))


def test_the_term_is_due_where_something_is_held_and_sees_the_window_alone():
    model, run = (trainer := begun("lifetimes")).model, trainer.objective.run
    (frame, *_), (width, height) = (i for i in run.views.train.tolist() if run.measured.held.of(i, 1, 1) is not None), run.views.size(1.0)
    bare = next(i for i in run.views.train.tolist() if run.measured.held.of(i, 1, 1) is None)
    term, now = MovingDepth(run), Now(frame, 0, 1.0, True)
    assert term.due(model, now) and term.inputs(model, now)[0].shape == (2, height, width)
    assert term.inputs(model, replace(now, window=(3, 5, 11, 9)))[0].shape == (2, 4, 8)
    assert term.inputs(model, replace(now, frame=bare)) is None
    assert not MovingDepth(replace(run, measured=Measured())).due(model, now)
    assert not MovingDepth(replace(run, settings=run.settings.model_copy(update={"depth_weight": 0.0}))).due(model, now)
