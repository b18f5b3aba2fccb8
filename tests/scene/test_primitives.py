"""Sets of primitives, their seeds, their surgery, and the optimiser state that follows them."""

import numpy as np
import pytest
import torch
from e4dgs.scene.fibonacci import fibonacci_sphere, neighbour_radius
from e4dgs.scene.motion.lifetimes.lifetime import set_lifetime
from e4dgs.scene.motion.rates import exponential
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.scene.rotation import quats_to_matrices
from e4dgs.scene.training.control.density import keep_small, survivors
from e4dgs.scene.training.control.splits import choose_to_split, split
from e4dgs.scene.training.optimiser import RowAdam


def gaussians(count=6, degree=1):
    rng = np.random.default_rng(0)
    return GaussianSet.from_points(rng.normal(size=(count, 3)), rng.uniform(size=(count, 3)), degree)


@pytest.mark.parametrize("count", [3, 4, 6, 8, 50])
def test_fibonacci_points_lie_on_the_sphere_and_balance(count):
    points = fibonacci_sphere(count)
    assert np.allclose(np.linalg.norm(points, axis=1), 1)
    assert np.linalg.norm(points.mean(0)) < 0.35
    assert abs(points[:, 2].mean()) < 1e-12


def test_neighbour_radius_is_the_mean_of_three():
    centres = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3], [100, 0, 0]])
    assert neighbour_radius(centres)[0] == pytest.approx(2.0)
    assert neighbour_radius(centres[:1])[0] == 1.0
    assert (neighbour_radius(np.zeros((4, 3))) > 0).all()


def test_a_convex_takes_the_place_of_its_gaussian():
    rng = np.random.default_rng(3)
    g = GaussianSet.from_points(rng.normal(size=(4, 3)), rng.uniform(size=(4, 3)), 1, opacity=0.7)
    with torch.no_grad():
        g.log_scales.copy_(torch.tensor([0.3, 0.1, 0.004]).log().expand(4, 3))
        g.quats.copy_(torch.from_numpy(rng.normal(size=(4, 4))))
        g.sh_rest.normal_()
    set_lifetime(g, torch.arange(4.0), 2.0, torch.ones(4, 3))
    g.dynamic[1] = False
    c = ConvexSet.replacing(g, 6)
    assert c.points.shape == (4, 6, 3) and c.points.is_leaf
    for name in set(ConvexSet.FIELDS) & set(GaussianSet.FIELDS):
        assert torch.equal(c.parameters[name], g.parameters[name]) and c.parameters[name].data_ptr() != g.parameters[name].data_ptr()
    assert torch.equal(c.dynamic, g.dynamic)
    arms = (c.points - g.means[:, None]).detach() @ quats_to_matrices(g.quats).detach()  # along the Gaussian's own axes
    in_deviations = (arms / g.log_scales.exp()[:, None]).norm(dim=2).detach()
    assert torch.allclose(in_deviations, torch.full_like(in_deviations, 1.9), rtol=1e-4)
    radius = 1.9 * (0.3 * 0.1) ** 0.5  # of what the image shows
    assert torch.allclose(c.log_tau.exp() * radius, torch.tensor(20.0)) and torch.allclose(c.log_kappa.exp() * radius, torch.tensor(20.0))


def test_colours_survive_the_round_trip_through_spherical_harmonics():
    from e4dgs.scene.primitives import SH_C0

    rng = np.random.default_rng(1)
    colors = rng.uniform(size=(5, 3))
    g = GaussianSet.from_points(rng.normal(size=(5, 3)), colors, 0)
    assert np.allclose(g.sh_dc.detach().numpy()[:, 0] * SH_C0 + 0.5, colors, atol=1e-6)


def test_rows_must_agree():
    g = gaussians()
    bad = {name: p.detach() for name, p in g.parameters.items()} | {"quats": torch.zeros(5, 4)}
    with pytest.raises(ValueError, match="same number of rows"):
        GaussianSet({name: bad[name] for name in GaussianSet.FIELDS})


def test_arrays_round_trip():
    g, c = gaussians(), ConvexSet.from_points(np.random.default_rng(0).normal(size=(3, 5, 3)), np.full((3, 3), 0.5), 1)
    for primitives in (g, c):
        again = type(primitives).from_arrays(primitives.to_arrays())
        assert all(torch.equal(p, again.parameters[name]) for name, p in primitives.parameters.items())


def test_split_keeps_the_centre_and_shrinks_the_longest_axis():
    g = gaussians(4)
    with torch.no_grad():
        g.log_scales[2] = torch.tensor([-1.0, 0.5, -2.0])
    new, source = split(g, torch.tensor([2]))
    assert source.tolist() == [0, 1, 3, -1, -1]
    children = new.means[3:].detach()
    assert torch.allclose(children.mean(0), g.means[2].detach(), atol=1e-6)
    assert torch.allclose((children[0] - children[1]).norm(), torch.tensor(0.5).exp(), atol=1e-5)
    assert float(new.log_scales[3, 1].exp()) == pytest.approx(0.6 * np.exp(0.5), rel=1e-5)
    stacked = 1 - (1 - new.opacities[3]) * (1 - new.opacities[4])
    assert stacked.item() == pytest.approx(g.opacities[2].item(), rel=1e-4)


def test_the_budget_is_a_ceiling_and_unseen_primitives_never_split():
    error = torch.tensor([0.0, 3.0, 1.0, 0.0, 2.0, 0.0])
    assert choose_to_split(gaussians(), error, 2).tolist() == [1, 4]
    assert choose_to_split(gaussians(), error, 100).tolist() == [1, 2, 4]
    assert choose_to_split(gaussians(), error, 0).numel() == 0


def test_survivors_are_opaque_finite_and_seen():
    g = gaussians(4)
    with torch.no_grad():
        g.opacity_logits[0] = -20
        g.means[1, 0] = float("nan")
    weight = torch.tensor([9.0, 9.0, 0.0, 9.0])
    assert survivors(g, 0.01).tolist() == [2, 3]
    assert survivors(g, 0.01, weight, 0.0).tolist() == [2, 3]
    assert survivors(g, 0.01, weight, 0.25).tolist() == [3]


def test_survivor_threshold_at_the_threshold():
    g = gaussians(1)
    opacity = float(g.opacities)
    weight = torch.tensor([0.25])
    assert survivors(g, opacity, weight, 0.25).tolist() == [0]
    assert survivors(g, opacity + 1e-4, weight, 0.25).tolist() == []
    assert survivors(g, opacity, weight, 0.2501).tolist() == []


def test_rotations_are_rotations():
    R = quats_to_matrices(torch.randn(50, 4, generator=torch.Generator().manual_seed(0)) * 10)
    assert torch.allclose(R @ R.transpose(1, 2), torch.eye(3).expand(50, 3, 3), atol=1e-5)
    assert torch.allclose(torch.linalg.det(R), torch.ones(50), atol=1e-5)


def test_adam_state_follows_its_rows():
    p = torch.zeros(3, 2, requires_grad=True)
    adam = RowAdam({"g.means": p}, {"g.means": exponential(0.1, 0.1)})
    p.grad = torch.tensor([[1.0, 1], [2, 2], [3, 3]])
    adam.step(0.0)
    moments = adam.state()["g.means/exp_avg"].clone()
    new = torch.zeros(3, 2, requires_grad=True)
    adam.replace("g.means", new, torch.tensor([2, -1, 0]))
    after = adam.state()["g.means/exp_avg"]
    assert torch.equal(after[0], moments[2]) and torch.equal(after[2], moments[0])
    assert after[1].abs().max() == 0
    new.grad = torch.ones(3, 2)
    adam.step(0.5)
    assert (new != 0).all()


def test_frozen_kinds_stay():
    a, b = torch.zeros(2, requires_grad=True), torch.zeros(2, requires_grad=True)
    adam = RowAdam({"gaussians.a": a, "convexes.b": b}, {"gaussians.a": exponential(1, 1), "convexes.b": exponential(1, 1)})
    a.grad, b.grad = torch.ones(2), torch.ones(2)
    adam.step(0.0, frozenset({"convexes"}))
    assert (a != 0).all() and (b == 0).all()


def test_exponential_rate_hits_both_ends():
    rate = exponential(1e-2, 1e-4)
    assert rate(0) == pytest.approx(1e-2) and rate(1) == pytest.approx(1e-4) and rate(0.5) == pytest.approx(1e-3)
    assert rate(2.0) == pytest.approx(1e-4)


def test_convexes_shrink_about_their_centroids_and_only_those_that_are_too_large():
    corners = torch.tensor([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    shapes = np.stack([(0.2 * corners + 3).numpy(), (0.1 * corners).numpy(), (0.1001 * corners).numpy()]).astype(np.float32)
    convexes = ConvexSet.from_points(shapes, np.zeros((3, 3), np.float32), 0)
    keep_small(convexes, 0.1, unless=torch.tensor(True))
    np.testing.assert_array_equal(convexes.points.detach(), shapes)
    keep_small(convexes, 0.1, unless=torch.tensor(False))
    np.testing.assert_allclose(convexes.points.detach(), np.stack([0.1 * corners + 3, 0.1 * corners, 0.1 * corners]), atol=1e-6)
    assert convexes.points.requires_grad and convexes.points.is_leaf
