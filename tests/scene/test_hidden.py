"""`seen_share`: what stands in front is seen whole, what stands behind as far as the front lets through, and `footprint` by rendering."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from e4dgs.rasterizer import Gaussians, rasterize
from e4dgs.scene.model import Model
from e4dgs.scene.motion.static import Static
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.scene.training.control.hidden import LEAST, footprint, seen_share
from e4dgs.scene.views import Views

FRONT, BEHIND = 0.75, 0.9  # opacities


def views(poses: list[np.ndarray]) -> Views:
    n = len(poses)
    K = np.tile(np.array([[60.0, 0, 32], [0, 60.0, 24], [0, 0, 1]]), (n, 1, 1))
    index = np.arange(n)
    picture = np.zeros((48, 64, 3), np.uint8)
    return Views(K, np.stack(poses), np.zeros(n), index, np.full(n, -1), index, 64, 48, lambda i: picture)


def ahead() -> np.ndarray:
    pose = np.eye(4)
    pose[2, 3] = 3.0
    return pose


def from_behind() -> np.ndarray:
    pose = ahead()
    pose[:3, :3] = np.diag([-1.0, 1.0, -1.0])
    return pose


def model() -> Model:
    """A wide one in front, a small one behind it on the optical axis, and one outside every picture."""
    gaussians = GaussianSet.from_points(np.array([[0, 0, 0], [0, 0, 1.0], [90.0, 0, 0]]), np.full((3, 3), 0.5), 0)
    with torch.no_grad():
        gaussians.log_scales.copy_(torch.tensor([0.5, 0.05, 0.1]).log()[:, None].expand(3, 3))
        gaussians.opacity_logits.copy_(torch.logit(torch.tensor([FRONT, BEHIND, BEHIND])))
    return Model(gaussians, ConvexSet.empty(6, 0), Static(), 0)


def test_what_is_behind_is_seen_as_far_as_the_front_lets_through():
    seen = seen_share(model(), views([ahead()]), [0], move=False)
    assert float(seen[0]) == pytest.approx(1, abs=0.05)
    assert float(seen[1]) == pytest.approx(1 - FRONT, abs=0.03)


def test_one_view_that_sees_it_is_enough():
    seen = seen_share(model(), views([ahead(), from_behind()]), [0, 1], move=False)
    assert float(seen[1]) == pytest.approx(1, abs=0.05)


def test_what_no_frame_could_see_is_not_judged():
    assert math.isinf(float(seen_share(model(), views([ahead()]), [0], move=False)[2]))
    small = model()
    with torch.no_grad():
        small.gaussians.opacity_logits[1] = torch.logit(torch.tensor(LEAST / 60))
    assert math.isinf(float(seen_share(small, views([ahead()]), [0], move=False)[1]))


def test_at_half_size_the_share_is_the_same():
    whole, half = (seen_share(model(), views([ahead()]), [0], move=False, scale=scale) for scale in (1.0, 0.5))
    assert whole[:2].tolist() == pytest.approx(half[:2].tolist(), abs=0.05)


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_a_footprint_is_what_a_picture_of_it_alone_sums_to(seed, antialiased):
    """Any orientation and place; the rasterizer leaves out what is fainter than 1/255, up to some percent of a strong one."""
    random = np.random.default_rng(seed)
    camera = views([ahead()]).rasterizer_camera(0)
    one = Gaussians(
        torch.tensor([[*random.uniform(-0.4, 0.4, 2), random.uniform(-1, 1)]], dtype=torch.float32),
        torch.tensor(random.normal(size=(1, 4)), dtype=torch.float32),
        torch.tensor(random.uniform(0.02, 0.25, (1, 3)), dtype=torch.float32),
        torch.tensor([0.95]),
        colors=torch.zeros(1, 3),
    )
    alone = float(rasterize(camera, replace(one), None, torch.zeros(3), antialiased=antialiased).alpha.sum())
    own = footprint(camera, one, dilation=0.0) if antialiased else footprint(camera, one)
    assert float(own) == pytest.approx(alone, rel=0.04)
