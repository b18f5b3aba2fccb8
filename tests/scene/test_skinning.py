"""The skinning kernel against plain torch in float64, its gradients against central differences, and how it meets bad numbers."""

import platform

import pytest
import torch
from e4dgs.scene.motion.nodes.nodes import Nodes
from e4dgs.scene.motion.nodes.skinning import nearest_nodes, skin, skin_reference

NAMES = ("points", "quats", "hyper", "home_hyper", "falloff", "turns", "shifts")


def scene(n=300, nodes=25, hyper=2, seed=0, dtype=torch.float64, offset=0.0):
    """Positions with quaternions, nodes turned by up to half a turn, and links to the nearest."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64).to(dtype)

    turns = torch.nn.functional.normalize(torch.tensor([1.0, 0, 0, 0]).to(dtype) + 0.8 * normal(nodes, 4), dim=1)
    falloff = 2 + normal(nodes).abs() * 5
    there = Nodes(normal(nodes, 3) + offset, 0.2 * normal(nodes, hyper), falloff, turns, 0.3 * normal(nodes, 3))
    points, quats, beside = normal(n, 3) + offset, normal(n, 4), 0.2 * normal(n, hyper)
    return points, quats, beside, nearest_nodes(points, beside, there, 4), there


def results(given, dtype, function):
    """Outputs and all gradients of a fixed weighting of them."""
    points, quats, hyper, link, nodes = given
    leaves = [p.detach().to(dtype).clone().requires_grad_() for p in (points, quats, hyper)]
    there = Nodes(*(p.detach().to(dtype).clone().requires_grad_() for p in nodes))
    moved, turned = function(*leaves, link, there)
    generator = torch.Generator().manual_seed(5)
    weights = [torch.randn(p.shape, generator=generator, dtype=torch.float64).to(dtype) for p in (moved, turned)]
    torch.autograd.backward([moved, turned], weights)
    return [moved.detach(), turned.detach(), *(p.grad for p in (*leaves, *there[1:]))]


@pytest.mark.parametrize(("n", "nodes", "hyper"), [(300, 25, 2), (1, 1, 2), (63, 2, 0), (1025, 3, 4), (5000, 40, 2)])
def test_the_kernel_agrees_with_the_oracle(n, nodes, hyper):
    given = scene(n, nodes, hyper)
    names = ("moved", "turned", *NAMES)
    for name, fast, exact in zip(names, results(given, torch.float32, skin), results(given, torch.float64, skin_reference)):
        assert torch.allclose(fast.double(), exact, rtol=2e-5, atol=2e-5 * float(exact.abs().amax() if exact.numel() else 1)), name


def test_the_oracles_gradients_are_central_differences():
    points, quats, hyper, link, nodes = scene(6, 5)
    inputs = {"quats": quats, "hyper": hyper, **{name: getattr(nodes, name) for name in NAMES[3:]}}
    generator = torch.Generator().manual_seed(1)
    weights = torch.randn(6, 3, generator=generator).double(), torch.randn(6, 4, generator=generator).double()

    def value(**changed):
        there = nodes._replace(**{name: changed.get(name, inputs[name]) for name in NAMES[3:]})
        moved, turned = skin_reference(points, changed.get("quats", quats), changed.get("hyper", hyper), link, there)
        return (moved * weights[0]).sum() + (turned * weights[1]).sum()

    for name, tensor in inputs.items():
        leaf = tensor.clone().requires_grad_()
        (gradient,) = torch.autograd.grad(value(**{name: leaf}), leaf)
        for index in range(0, tensor.numel(), 3):
            step = torch.zeros(tensor.numel(), dtype=torch.float64)
            step[index] = 1e-6
            step = step.view(tensor.shape)
            slope = (value(**{name: tensor + step}) - value(**{name: tensor - step})) / 2e-6
            assert abs(float(slope - gradient.flatten()[index])) < 1e-5 * (1 + abs(float(slope))), name


def test_a_position_turns_along_with_its_nodes():
    """Its gradient is that of the blended rotation, and none comes through the weights."""
    points, quats, hyper, link, nodes = scene(40, 1)
    leaf = points.float().requires_grad_()
    moved, _ = skin(leaf, quats.float(), hyper.float(), link, Nodes(*(p.float() for p in nodes)))
    (gradient,) = torch.autograd.grad(moved[:, 0].sum(), leaf)
    assert torch.allclose(gradient, gradient[:1].expand_as(gradient), atol=1e-6)  # one rotation for all
    assert torch.allclose(gradient.norm(dim=1), torch.ones(40), atol=1e-5)


def test_the_nearest_nodes_are_those_that_weigh_most():
    points, _, hyper, _, nodes = scene(500, 60, dtype=torch.float32)
    link = nearest_nodes(points, hyper, nodes, 4)
    distance = torch.cdist(torch.cat([points, hyper], 1).double(), torch.cat([nodes.home, nodes.home_hyper], 1).double()).square()
    exact = (distance * nodes.falloff.double()).topk(4, largest=False).indices
    assert (link.long() == exact).float().mean() > 0.999  # ties in float32
    assert nearest_nodes(points, hyper, Nodes(*(p[:2] for p in nodes)), 4).shape == (500, 2)


def test_far_from_the_origin_nothing_is_lost():
    near, far = scene(dtype=torch.float64), scene(dtype=torch.float64, offset=1024.0)
    for a, b in zip(results(near, torch.float32, skin)[1:], results(far, torch.float32, skin)[1:]):
        assert torch.allclose(a, b, rtol=5e-3, atol=5e-3 * float(a.abs().amax()))  # positions themselves are rounded to 6e-5 there


def test_any_number_of_threads_gives_the_same_bits():
    given = scene(5000, 40)
    before = torch.get_num_threads()
    try:
        runs = []
        for threads in (1, 2, 4):
            torch.set_num_threads(threads)
            runs.append(results(given, torch.float32, skin))
    finally:
        torch.set_num_threads(before)
    for other in runs[1:]:
        assert all(torch.equal(a, b) for a, b in zip(runs[0], other))


def test_positions_without_a_gradient_take_no_part():
    points, quats, hyper, link, nodes = scene(500, 40, dtype=torch.float32)
    seen = torch.arange(500) % 7 == 2
    found = []
    for rows in (torch.ones(500, dtype=torch.bool), seen):
        leaves = [p[rows].clone().requires_grad_() for p in (points, quats, hyper)]
        there = Nodes(*(p.clone().requires_grad_() for p in nodes))
        moved, turned = skin(*leaves, link[rows], there)
        (moved[seen[rows]].sum() + turned[seen[rows]].square().sum()).backward()
        assert all(not p.grad[~seen[rows]].any() for p in leaves)
        found.append([p.grad[seen[rows]] for p in leaves] + [p.grad for p in there[1:]])
    assert all(torch.equal(a, b) and a.any() for a, b in zip(*found))


def test_bad_links_and_shapes_are_refused():
    points, quats, hyper, link, nodes = scene(8, 5, dtype=torch.float32)
    with pytest.raises(ValueError, match="not there"):
        skin(points, quats, hyper, link + 5, nodes)
    with pytest.raises(ValueError, match="rest_hyper"):
        skin(points, quats, hyper[:4], link, nodes)
    with pytest.raises(ValueError, match="turns"):
        skin(points, quats, hyper, link, nodes._replace(turns=nodes.turns[:2]))


def test_one_bad_position_harms_no_other():
    points, quats, hyper, link, nodes = scene(100, 9, dtype=torch.float32)
    good = skin(points, quats, hyper, link, nodes)
    points = points.clone()
    points[7] = float("nan")
    bad = skin(points, quats, hyper, link, nodes)
    others = torch.arange(100) != 7
    assert all(torch.equal(a[others], b[others]) for a, b in zip(good, bad))
    assert not torch.isfinite(bad[0][7]).any()


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="other processors are not slowed by such numbers")
def test_numbers_below_the_normal_ones_are_zero_inside_and_only_there():
    points, quats, hyper, link, nodes = scene(200, 9, dtype=torch.float32)
    points.requires_grad_()
    moved, _ = skin(points, quats, hyper, link, nodes)
    moved.backward(torch.full_like(moved, 1e-41))
    assert not points.grad.any()
    assert float(torch.tensor(1e-41) * 2) > 0
