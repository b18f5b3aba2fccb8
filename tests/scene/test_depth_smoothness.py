"""What bends costs, unless the picture has an edge there; planes cost nothing."""

import numpy as np
import pytest
import torch
from e4dgs.scene.losses.depth_smoothness import COVERED, depth_smoothness

SIZE = 20


def plane(tilt=(0.02, -0.01)) -> torch.Tensor:
    y, x = torch.meshgrid(*(torch.arange(SIZE, dtype=torch.float64),) * 2, indexing="ij")
    return 1 / (0.5 + tilt[0] * x / SIZE + tilt[1] * y / SIZE)


def flat() -> torch.Tensor:
    return torch.full((SIZE, SIZE, 3), 0.5, dtype=torch.float64)


def cost(depth, alpha=None, image=None, unit=2.0) -> float:
    return float(depth_smoothness(depth, torch.ones_like(depth) if alpha is None else alpha, flat() if image is None else image, unit))


def test_planes_cost_nothing_and_floaters_do():
    assert cost(plane()) == pytest.approx(0, abs=1e-12)
    floater = plane()
    floater[10, 10] *= 0.5
    assert cost(floater) > 1e-3
    assert cost(3 * floater, unit=6.0) == pytest.approx(cost(floater)), "the same in any unit of length"


def test_a_step_in_depth_is_free_where_the_picture_has_one():
    step, image = plane(), flat()
    step[:, 10:] *= 2
    image[:, 10:] = 0.9
    assert cost(step, image=image) < 1e-3 * cost(step)


def test_where_nothing_covers_the_picture_there_is_no_surface():
    rough = plane() * torch.from_numpy(np.random.default_rng(0).uniform(0.5, 1.5, (SIZE, SIZE)))
    assert cost(rough, torch.full_like(rough, 0.9 * COVERED)) == 0 < cost(rough)


def test_gradients_are_right():
    rng = np.random.default_rng(1)
    depth = (plane() * torch.from_numpy(rng.uniform(0.9, 1.1, (SIZE, SIZE))))[:6, :7].clone().requires_grad_()
    alpha = torch.from_numpy(rng.uniform(0.7, 1, (6, 7))).requires_grad_()
    image = torch.from_numpy(rng.uniform(0.4, 0.42, (6, 7, 3)))
    assert torch.autograd.gradcheck(lambda d, a: depth_smoothness(d, a, image, 2.0), (depth, alpha))
