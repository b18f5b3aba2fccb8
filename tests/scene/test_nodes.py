"""Control nodes: rigid where they agree, smooth between them, steady where they have not been yet."""

import numpy as np
import pytest
import torch
from e4dgs.scene.model import Model
from e4dgs.scene.motion.nodes import ControlNodes, aligned, farthest_points
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from e4dgs.scene.rotation import quats_to_matrices


def some(count=12, keys=5, reach=0.5, seed=0, **options):
    rng = np.random.default_rng(seed)
    return ControlNodes(torch.tensor(rng.uniform(-1, 1, (count, 3))), keys, reach, **options)


def turn(degrees, axis=(0.0, 0.0, 1.0)):
    half = np.radians(degrees) / 2
    axis = np.array(axis) / np.linalg.norm(axis)
    return torch.tensor(np.concatenate([[np.cos(half)], np.sin(half) * axis])).float()


def points(count=40, seed=1):
    return torch.rand(count, 3, generator=torch.Generator().manual_seed(seed)) * 2 - 1


def angle(a, b):
    """Degrees between unit quaternions."""
    cosine = (a * b).sum().abs().clamp(max=1).item()
    return float(np.degrees(2 * np.arccos(cosine)))


def test_untrained_nodes_move_nothing():
    moved = some()(points(), 0.3)
    assert moved.dx.abs().max() < 1e-6 and not moved.ds.any()
    assert torch.allclose(moved.dr, torch.tensor([1.0, 0, 0, 0]).expand(40, 4))


def test_nodes_that_share_a_rigid_motion_carry_everything_along():
    nodes, quat, shift = some(), turn(50, (1, 2, 3)), torch.tensor([0.3, -0.2, 0.1])
    R = quats_to_matrices(quat[None])[0]
    with torch.no_grad():
        nodes.quats[:] = 3 * quat  # any norm
        nodes.shifts[:] = (nodes.positions @ R.T + shift - nodes.positions) / nodes.reach
    rest = points()
    moved = nodes(rest, 0.7)
    assert torch.allclose(rest + moved.dx, rest @ R.T + shift, atol=1e-5)
    assert torch.allclose(moved.dr, quat.expand(40, 4), atol=1e-6)
    assert nodes.priors(rest, rest, 0.7, 0.1)[0] < 1e-5  # rigid: no strain


def test_a_quaternion_and_its_negative_blend_as_the_one_turn_that_they_are():
    nodes = some()
    with torch.no_grad():
        nodes.quats[:] = turn(30)
        nodes.quats[:, ::2] *= -1
    dr = nodes(points(), 0.5).dr
    assert all(angle(q, turn(30)) < 0.05 for q in dr)


def test_weights_sum_to_one_and_carry_no_gradient():
    weights, index = some().skinning(points().requires_grad_())
    assert torch.allclose(weights.sum(1), torch.ones(40)) and not weights.requires_grad
    assert (weights >= 0).all() and all(len(set(row.tolist())) == 4 for row in index)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_fewer_nodes_than_share_a_position(count):
    nodes = some(count, keys=1)
    with torch.no_grad():
        nodes.shifts[:] = 1.0
    assert torch.allclose(nodes(points(), 0.4).dx, torch.full((40, 3), nodes.reach), atol=1e-6)


def test_gradients_agree_with_central_differences():
    nodes = some(6, keys=3).double()
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        for p in nodes.parameters():
            p += 0.3 * torch.randn(p.shape, generator=generator, dtype=p.dtype)
    rest = points(5).double()

    def moved(quats, shifts):
        return torch.func.functional_call(nodes, {"quats": quats, "shifts": shifts}, (rest, 0.3))[:2]

    assert torch.autograd.gradcheck(moved, tuple(p.detach().clone().requires_grad_() for p in (nodes.quats, nodes.shifts)), eps=1e-6)

    def priors(quats, shifts):
        nodes.opened[:] = torch.tensor([0, 2])
        with torch.no_grad():
            saved = [p.clone() for p in nodes.parameters()]
        try:
            nodes.quats, nodes.shifts = torch.nn.Parameter(quats), torch.nn.Parameter(shifts)
            return [x.item() for x in nodes.priors(rest, rest, 0.3, 0.5)]
        finally:
            nodes.quats, nodes.shifts = (torch.nn.Parameter(p) for p in saved)

    nodes.opened[:] = torch.tensor([0, 2])
    for term in (0, 1):
        nodes.zero_grad()
        nodes.priors(rest, rest, 0.3, 0.5)[term].backward()
        for k, p in enumerate((nodes.quats, nodes.shifts)):
            gradient = torch.zeros_like(p) if p.grad is None else p.grad.clone()
            direction = torch.randn(p.shape, generator=generator, dtype=p.dtype)
            sides = []
            for sign in (1, -1):
                values = [nodes.quats.detach().clone(), nodes.shifts.detach().clone()]
                values[k] += sign * 1e-6 * direction
                sides.append(priors(*values)[term])
            assert (sides[0] - sides[1]) / 2e-6 == pytest.approx((gradient * direction).sum().item(), rel=1e-4, abs=1e-7)


def test_a_rest_position_is_pulled_through_the_turn_that_it_makes():
    nodes = some()
    with torch.no_grad():
        nodes.quats[:] = turn(90)
    rest = points().requires_grad_()
    (rest + nodes(rest, 0.5).dx)[:, 1].sum().backward()  # what is y now was x at rest
    assert torch.allclose(rest.grad, torch.tensor([1.0, 0, 0]).expand(40, 3), atol=1e-5)


def test_keys_that_come_in_go_on_at_the_speed_of_those_before_them():
    nodes = some(keys=9)
    assert nodes.opened.tolist() == [4, 4]
    with torch.no_grad():
        nodes.extend(3 / 8, 5 / 8)
        assert nodes.opened.tolist() == [3, 5] and torch.equal(nodes.quats[5], nodes.quats[4])
        for k in (3, 4, 5):
            nodes.quats[k], nodes.shifts[k] = turn(20 * (k - 4), (1, 1, 0)), 0.1 * (k - 4)
    nodes.extend(0.2, 0.64)
    assert nodes.opened.tolist() == [1, 6]
    assert angle(nodes.quats[6][0], turn(40, (1, 1, 0))) < 0.05 and angle(nodes.quats[1][0], turn(-60, (1, 1, 0))) < 0.05
    assert torch.allclose(nodes.shifts[6], torch.tensor(0.2)) and torch.allclose(nodes.shifts[1], torch.tensor(-0.3))
    assert torch.equal(nodes.quats[8][0], turn(0)) and not nodes.shifts[[0, 7, 8]].any()  # not asked for yet
    nodes.extend(0, 1)
    assert nodes.opened.tolist() == [0, 8]


def test_other_nodes_and_keys_keep_the_path():
    nodes = some(keys=4)
    with torch.no_grad():
        nodes.shifts += 0.3 * torch.randn((4, 1, 3), generator=torch.Generator().manual_seed(0))  # all nodes alike
    finer = nodes.resampled(points(25, seed=9), 7)
    assert finer.keys == 7 and finer.opened.tolist() == [0, 6] and len(finer.positions) == 25
    for k in range(7):
        for a, b in zip(nodes(points(), k / 6), finer(points(), k / 6)):
            assert torch.allclose(a, b, atol=1e-5)
    with torch.no_grad():
        nodes.quats += 0.2 * torch.randn(nodes.quats.shape, generator=torch.Generator().manual_seed(1))
    assert torch.allclose(nodes.resampled(points(25), 4)(points(25), 1.0).dr.norm(dim=1), torch.ones(25))
    here = nodes(points(25), 1 / 3)
    moved = nodes.resampled(points(25), 4).pose(1 / 3)[1]
    assert torch.allclose(moved, here.dx, atol=1e-5)


def test_a_body_alone_moves_what_lies_within_it_and_nothing_else():
    nodes, centre = some(40), torch.tensor([0.6, 0.0, 0.0])
    quats = torch.stack([turn(100.0 * k) for k in range(5)])
    path = centre + torch.linspace(0, 1, 5)[:, None] * torch.tensor([0.0, 0, 2.0])
    with_body = nodes.with_body(centre, 0.3, quats, path)
    dropped = int(((nodes.positions - centre).norm(dim=1) <= 0.3).sum())
    assert len(with_body.positions) == 40 - dropped + 1
    inside = centre + 0.25 * torch.nn.functional.normalize(points() - 0.01, dim=1)
    outside = centre + 0.35 * torch.nn.functional.normalize(points() - 0.01, dim=1)
    for k in range(5):
        R = quats_to_matrices(quats[k : k + 1])[0]
        moved = with_body(inside, k / 4)
        assert torch.allclose(inside + moved.dx, (inside - centre) @ R.T + path[k], atol=1e-5)
        assert with_body(outside, k / 4).dx.abs().max() < 1e-6
    # Signs are chosen for the short way round: half-way between two keys the turn is half-way, too.
    assert angle(with_body(inside, 0.125).dr[0], turn(50)) < 0.1
    rest = points()
    assert with_body.priors(rest, rest, 0.5, 0.1)[0].item() < 1e-6  # a body strains nobody


def test_aligned_flips_whole_runs():
    quats = torch.stack([turn(10.0 * k) * (-1) ** (k in (2, 3)) for k in range(6)])[:, None]
    out = aligned(quats)
    assert ((out[1:] * out[:-1]).sum(2) > 0.9).all() and torch.equal(out[0], quats[0])


def test_a_model_with_nodes_survives_its_arrays():
    gaussians = GaussianSet.from_points(points().numpy(), np.full((40, 3), 0.5), 0)
    nodes = some(8, exclusive=torch.tensor([0.4] + 7 * [0.0]))
    with torch.no_grad():
        nodes.shifts += 0.1 * torch.randn(nodes.shifts.shape, generator=torch.Generator().manual_seed(0))
    model = Model(gaussians, ConvexSet.empty(6, 0), nodes, 0)
    again = Model.from_arrays(model.to_arrays(), model.config)
    assert torch.equal(model.at(0.37)[0].means, again.at(0.37)[0].means)
    with pytest.raises(KeyError):
        Model.from_arrays({k: v for k, v in model.to_arrays().items() if k != "field_exclusive"}, model.config)


def test_farthest_points_cover_the_set_and_never_repeat():
    cloud = np.concatenate([np.random.default_rng(0).normal(size=(200, 3)) * 0.01, np.eye(3) * 5])
    chosen = farthest_points(cloud, 4)
    assert {tuple(p) for p in np.eye(3) * 5} <= {tuple(p) for p in chosen}
    assert len(farthest_points(np.zeros((10, 3)), 4)) == 1
