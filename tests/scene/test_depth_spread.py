"""`depth_spread`: none for a surface, the distance's share for two layers, with the gradient of central differences."""

import pytest
import torch
from e4dgs.rasterizer import Camera, Convexes, Gaussians, rasterize
from e4dgs.scene.losses.depth_spread import depth_spread, with_depth

UNIT = 2.0
CAMERA = Camera(torch.tensor([[40.0, 0, 16], [0, 40.0, 12], [0, 0, 1]]), torch.eye(4), 32, 24)


def layers(depths: list[float], opacities: list[float]) -> Gaussians:
    """Discs before the camera that fill its picture, faced to it."""
    n = len(depths)
    means = torch.tensor([[0.0, 0.0, z] for z in depths]).reshape(n, 3)
    quats = torch.tensor([[1.0, 0, 0, 0]]).expand(n, 4).contiguous()
    scales = torch.tensor([[20.0, 20.0, 1e-3]]).expand(n, 3).contiguous()
    return Gaussians(means, quats, scales, torch.tensor(opacities), colors=torch.zeros(n, 3))


def none() -> Convexes:
    return Convexes(torch.zeros(0, 6, 3), torch.zeros(0), torch.zeros(0), torch.zeros(0), colors=torch.zeros(0, 3))


def spread_of(gaussians: Gaussians, convexes: Convexes | None = None) -> torch.Tensor:
    seen = with_depth(CAMERA, gaussians, none() if convexes is None else convexes, UNIT)
    frame = rasterize(CAMERA, *seen, torch.zeros(3))
    return depth_spread(frame.extras, frame.alpha)


def test_one_surface_has_no_spread():
    assert float(spread_of(layers([5.0], [0.9]))) == pytest.approx(0, abs=2e-4)
    assert float(spread_of(layers([5.0, 5.0], [0.5, 0.9]))) == pytest.approx(0, abs=2e-4)


def test_two_layers_have_the_standard_deviation_of_their_weights():
    """The rear one gets what the front one lets through."""
    front, rear = 0.5, 0.5 * 0.8
    alpha = front + rear
    expected = (front * rear) ** 0.5 / alpha * (0.6 / UNIT) * alpha**0.5
    assert float(spread_of(layers([5.0, 5.6], [0.5, 0.8]))) == pytest.approx(expected, rel=0.03)


def test_what_is_hidden_does_not_count():
    assert float(spread_of(layers([5.0, 9.0], [0.999, 0.9]))) < 0.25 * float(spread_of(layers([5.0, 9.0], [0.5, 0.9])))


def box(near: float, far: float) -> Convexes:
    corners = torch.tensor([[x, y, z] for x in (-9.0, 9.0) for y in (-9.0, 9.0) for z in (near, far)])[None]
    return Convexes(corners, torch.tensor([50.0]), torch.tensor([50.0]), torch.tensor([0.9]), colors=torch.zeros(1, 3))


def test_a_thin_convex_counts_as_a_surface():
    two = float(spread_of(layers([5.0], [0.5]), box(6.99, 7.01)))
    assert two == pytest.approx(float(spread_of(layers([5.0, 7.0], [0.5, 0.9]))), rel=0.03)


def test_a_thick_convex_is_spread_by_itself():
    alone = float(spread_of(layers([], []), box(6.0, 8.0)))
    assert alone == pytest.approx(1.0 / UNIT * 0.9**0.5, rel=0.03), "half its thickness"


def test_a_weight_acts_on_the_gradient_of_its_pixel_and_not_on_the_loss():
    extras, alpha = torch.rand(3, 4, 2, dtype=torch.float64), torch.rand(3, 4, dtype=torch.float64)
    weight = torch.rand(3, 4, dtype=torch.float64)
    weight[0] = 0
    found = []
    for given in (None, weight):
        leaves = extras.clone().requires_grad_(), alpha.clone().requires_grad_()
        loss = depth_spread(*leaves, given)
        found.append((float(loss.detach()), *torch.autograd.grad(loss, leaves)))
    (plain, by_extras, by_alpha), (weighted, *gradients) = found
    assert plain == weighted
    assert torch.allclose(gradients[0], by_extras * weight[..., None]) and torch.allclose(gradients[1], by_alpha * weight)


def test_its_gradient_is_that_of_central_differences():
    """By the depth of the rear layer and by the opacity of the front one: layers are drawn together, and the front one closes."""
    depths, opacities = torch.tensor([5.0, 5.6]), torch.tensor([0.5, 0.8])

    def value(z: torch.Tensor, o: torch.Tensor) -> torch.Tensor:
        base = layers([5.0, 5.6], [0.5, 0.8])
        means = torch.cat([base.means[:, :2], z[:, None]], 1)
        return spread_of(Gaussians(means, base.quats, base.scales, o, colors=base.colors))

    z, o = depths.clone().requires_grad_(), opacities.clone().requires_grad_()
    value(z, o).backward()
    for k, step, gradient, name in ((1, 1e-2, z.grad, "z"), (0, 1e-2, o.grad, "o")):
        moved = [depths.clone(), opacities.clone()]
        ends = []
        for sign in (1, -1):
            at = [m.clone() for m in moved]
            at[0 if name == "z" else 1][k] += sign * step
            ends.append(float(value(*at)))
        # The origin of the depths moves with their mean, which changes no spread.
        assert float(gradient[k]) == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=0.03), name
    assert float(z.grad[1]) > 0 and float(o.grad[0]) < 0
