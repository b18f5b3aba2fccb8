"""The fused terms on depth against plain torch in float64. For the terms themselves, see test_depth_smoothness.py and test_sweep.py."""

import pytest
import torch
from e4dgs.scene.losses.surface import surface_loss

UNIT = 3.0


def inputs(height, width, seed=0):
    """Depth, alpha, image, and what else the loss may be given: rough surfaces, holes, edges, unknown and moving pixels."""
    g = torch.Generator().manual_seed(seed)
    depth = UNIT * (0.5 + torch.rand(height, width, generator=g))
    depth[torch.rand(height, width, generator=g) < 0.05] = 0.0
    alpha = torch.rand(height, width, generator=g) ** 0.3
    image = 0.5 + 0.02 * torch.rand(height, width, 3, generator=g)
    measured = (alpha / depth.clamp(min=0.1) + 0.05 * torch.randn(height, width, generator=g)).clamp(min=0)
    moving = torch.rand(-(-height // 4), -(-width // 4), generator=g) < 0.3
    weight = (torch.rand(height, width, generator=g) * 4).round()
    return depth, alpha, image, {"measured": measured, "moving": moving, "weight": weight}


GIVEN = {"nothing": (), "measured": ("measured",), "moving": ("measured", "moving"), "all": ("measured", "moving", "weight")}


@pytest.mark.parametrize("given", GIVEN.values(), ids=GIVEN.keys())
@pytest.mark.parametrize(("smooth", "measure"), [(2.0, 0.3), (0.0, 0.3), (2.0, 0.0)])
@pytest.mark.parametrize(("height", "width"), [(1, 1), (2, 9), (9, 2), (3, 3), (37, 53)])
def test_value_and_gradient_match_the_oracle(height, width, smooth, measure, given):
    depth, alpha, image, more = inputs(height, width)
    more = {name: more[name] for name in given}
    ours = [depth.clone().requires_grad_(), alpha.clone().requires_grad_()]
    loss = surface_loss(*ours, image, UNIT, smooth, measure, **more)
    exact = [x.double().requires_grad_() for x in (depth, alpha)]
    more = {name: x.double() if x.is_floating_point() else x for name, x in more.items()}
    expected = surface_loss(*exact, image.double(), UNIT, smooth, measure, **more)
    if not expected.requires_grad:  # an image too small for any term
        expected = expected + 0 * sum(x.sum() for x in exact)
    assert float(loss) == pytest.approx(float(expected), rel=1e-5, abs=1e-9)
    for one, other in zip(torch.autograd.grad(loss, ours), torch.autograd.grad(expected, exact)):
        assert (one - other).norm() <= 1e-5 * other.norm() + 1e-9


def test_bit_equal_for_any_number_of_threads():
    depth, alpha, image, more = inputs(67, 45)
    before, results = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 4):
            torch.set_num_threads(threads)
            ours = [depth.clone().requires_grad_(), alpha.clone().requires_grad_()]
            loss = surface_loss(*ours, image, UNIT, 2.0, 0.3, **more)
            results.append((loss.detach(), *torch.autograd.grad(loss, ours)))
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(a, b) for result in results for a, b in zip(result, results[0]))
