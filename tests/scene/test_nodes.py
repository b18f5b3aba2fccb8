"""Control nodes: rigid where they agree, smooth between them, the same model after saving."""

import numpy as np
import pytest
import torch
from e4dgs.scene.model import Model
from e4dgs.scene.motion.carrier import Places
from e4dgs.scene.motion.nodes.control_nodes import ControlNodes
from e4dgs.scene.motion.nodes.courses import RANK, SharedCourses, encode, encode_places
from e4dgs.scene.motion.nodes.rigid_parts import RigidParts
from e4dgs.scene.motion.nodes.spread import farthest_points, spacing
from e4dgs.scene.primitives import ConvexSet, GaussianSet


def some(count=12, seed=0):
    rng = np.random.default_rng(seed)
    return ControlNodes(torch.tensor(rng.uniform(-1, 1, (count, 3))), torch.zeros(3), extent=1.0, reach=0.5, seed=seed)


def moving(count=12, seed=0):
    """Nodes whose heads have been given something to do."""
    nodes = some(count, seed)
    with torch.no_grad():
        nodes.network.place[-1].weight.normal_(0, 0.5, generator=torch.Generator().manual_seed(seed))
    return nodes


def rest(n=40, seed=1):
    generator = torch.Generator().manual_seed(seed)
    points, quats = torch.rand(n, 3, generator=generator) * 2 - 1, torch.randn(n, 4, generator=generator)
    return Places(points, quats, {"hyper": torch.zeros(n, 2)}, None)


def steer(nodes, output):
    """Every node and time gets the same seven numbers from the network."""
    with torch.no_grad():
        for head in (nodes.network.place[-1], nodes.network.time[-1]):
            head.weight.zero_()
        nodes.network.time[-1].bias.fill_(1.0)
        nodes.network.place[-1].bias.copy_((torch.tensor(output) / RANK**0.5).repeat_interleave(RANK))
    return nodes


def test_untrained_nodes_move_next_to_nothing():
    given = rest()
    moved = some().carry(given, 0.3)
    assert (moved.points - given.points).abs().max() < 2e-3
    assert moved.log_scales is None
    assert torch.allclose(moved.quats, given.quats, atol=2e-3)


def test_nodes_that_share_a_shift_carry_everything_along():
    nodes, given = steer(some(), [0.0, 0, 0, 0, 1.0, -2.0, 0.5]), rest()
    moved = nodes.carry(given, 0.7)
    shift = 0.3 * 0.5 * torch.tensor([1.0, -2.0, 0.5])
    assert torch.allclose(moved.points, given.points + shift, atol=1e-6)
    assert torch.allclose(moved.quats, given.quats, atol=1e-6)
    assert nodes.priors(given.points, given.points, 0.7, 0.1)[0] < 1e-6  # a shift strains nothing


def test_a_lone_node_turns_what_it_carries_about_itself():
    nodes = steer(
        ControlNodes(torch.zeros(1, 3), torch.zeros(3), 1.0, 1.0), [-1 / 0.3 + np.sqrt(0.5) / 0.3, 0, 0, np.sqrt(0.5) / 0.3, 0, 0, 0]
    )
    moved = nodes.carry(Places(torch.tensor([[1.0, 0, 0]]), torch.tensor([[1.0, 0, 0, 0]]), {"hyper": torch.zeros(1, 2)}, None), 0.5)
    assert torch.allclose(moved.points, torch.tensor([[0.0, 1, 0]]), atol=1e-6)  # a quarter turn about z
    assert torch.allclose(moved.quats, torch.tensor([[np.sqrt(0.5), 0, 0, np.sqrt(0.5)]]).float(), atol=1e-6)


def test_turning_in_place_strains_the_graph():
    turning = steer(some(), [0.0, 0, 0, 3.0, 0, 0, 0])
    assert turning.priors(torch.zeros(1, 3), torch.zeros(1, 3), 0.5, 0.1)[0] > 0.1


def test_gradients_reach_every_parameter():
    nodes, given = moving(), rest()
    hyper = torch.full((40, 2), 0.1, requires_grad=True)
    moved = nodes.carry(given._replace(attributes={"hyper": hyper}), 0.4)
    rigidity, course = nodes.priors(given.points, given.points, 0.4, 0.1)
    (moved.points.square().sum() + moved.quats.square().sum() + rigidity + course + nodes.light(0.4).square().sum()).backward()
    for name, parameter in nodes.named_parameters():
        assert not parameter.numel() or (
            parameter.grad is not None and torch.isfinite(parameter.grad).all() and parameter.grad.abs().sum() > 0
        ), name
    assert hyper.grad.abs().sum() > 0


@pytest.mark.parametrize("part", ["place", "time"])
def test_units_that_are_zero_everywhere_still_learn(part):
    nodes = moving()
    layers = getattr(nodes.network, part)
    with torch.no_grad():
        layers[-2].bias.fill_(-50.0)
    given = rest()
    nodes.carry(given, 0.4).points.square().sum().backward()
    assert all(float(layer.weight.grad.abs().max()) > 0 for layer in layers)


def test_a_place_takes_its_share_of_the_courses():
    """Against the sum that the network stands for, one place and time after another, in float64."""
    network = SharedCourses(seed=2).double()
    with torch.no_grad():
        network.place[-1].weight.normal_(0, 0.5, generator=torch.Generator().manual_seed(1))
    places, times = torch.rand(5, 3, dtype=torch.float64) * 2 - 1, [0.0, 0.3, 1.0]
    found = network(encode_places(places), torch.tensor(times, dtype=torch.float64))

    def through(layers, x):
        for number, layer in enumerate(layers):
            x = layer.weight @ x + layer.bias
            x = x if number == len(layers) - 1 else torch.where(x < 0, 0.01 * x, x)
        return x

    for place, of_place in zip(places, found.transpose(0, 1)):
        share = through(network.place, encode_places(place[None])[0]).reshape(7, RANK)
        for time, outputs in zip(times, of_place):
            expected = share @ through(network.time, encode(torch.tensor([[time]], dtype=torch.float64), 6)[0]) / RANK**0.5
            assert torch.allclose(outputs, expected, rtol=1e-12, atol=1e-12)


def test_with_and_without_gradients_nodes_are_the_same_bit_for_bit():
    """What is exported is what is rendered."""
    nodes = moving()
    there = nodes.at(0.4)
    with torch.no_grad():
        assert all(torch.equal(p, q) for p, q in zip(nodes.at(0.4), there))


def test_several_times_at_once_are_those_one_by_one():
    nodes = moving()
    for t, together in zip((0.0, 0.4, 2.0), nodes.at_times([0.0, 0.4, 2.0])):
        assert torch.allclose(together.shifts, nodes.at(min(t, 1.0)).shifts, atol=1e-6)
        assert torch.allclose(together.turns, nodes.at(min(t, 1.0)).turns, atol=1e-6)


def test_a_model_of_a_version_with_another_network_is_refused():
    nodes = moving()
    state = {name.replace("network.place", "layers"): value for name, value in nodes.state_dict().items()}
    with pytest.raises(KeyError, match="network"):
        ControlNodes.from_state(state, nodes.config)


def test_what_is_kept_of_the_places_follows_a_state_that_is_loaded():
    nodes, other = moving(), moving(seed=3)
    nodes.at(0.4), nodes.graph()
    nodes.load_state_dict(other.state_dict())
    assert torch.equal(nodes.at(0.4).shifts, other.at(0.4).shifts) and torch.equal(nodes.graph(), other.graph())


def test_nothing_is_kept_that_a_cuda_graph_in_the_making_computes(monkeypatch):
    """It would lie in memory that other graphs write to."""
    nodes, other = moving(), moving()
    monkeypatch.setattr("e4dgs.scene.motion.nodes.control_nodes.in_capture", lambda device: True)
    strain, _ = nodes.priors(torch.zeros(0, 3), torch.zeros(0), 0.5, 0.1)
    assert not nodes._known
    monkeypatch.undo()
    assert torch.equal(nodes.priors(torch.zeros(0, 3), torch.zeros(0), 0.5, 0.1)[0], strain)
    model = Model(GaussianSet.from_points(rest(4).points.numpy(), np.full((4, 3), 0.5), 0), ConvexSet.empty(6, 0), other, 0)
    model.in_rooms([(model.gaussians, torch.arange(4), None), (model.convexes, torch.arange(0), None)])
    assert other._known.keys() == nodes._known.keys() == {"graph", "place"}


def test_hyper_coordinates_part_what_touches():
    """Two nodes at one place, one of which moves: what lies with the other beside space stays."""
    nodes = ControlNodes(torch.tensor([[0.0, 0, 0], [0.0, 0, 1e-3]]), torch.zeros(3), 1.0, 1.0)
    with torch.no_grad():
        nodes.log_radii.fill_(np.log(0.1))
        nodes.hyper.copy_(torch.tensor([[1.0, 0], [-1.0, 0]]))
        given = Places(torch.zeros(2, 3), torch.tensor([[1.0, 0, 0, 0]]).repeat(2, 1), {"hyper": torch.tensor([[1.0, 0], [-1.0, 0]])}, None)
        link = nodes.nearest(given.points, given.attributes["hyper"])
    assert link[:, 0].tolist() == [0, 1]


def test_saved_and_read_back_nodes_move_alike():
    nodes = moving(7)
    g = GaussianSet.from_points(rest().points.numpy(), np.full((40, 3), 0.5), 0)
    model = Model(g, ConvexSet.empty(6, 0), nodes, 0)
    again = Model.from_arrays(model.to_arrays(), model.config)
    for t in (0.0, 0.3, 1.0):
        assert torch.equal(model.at(t)[0].means, again.at(t)[0].means)


def test_links_are_kept_until_asked_for_anew():
    model = Model(GaussianSet.from_points(rest().points.numpy(), np.full((40, 3), 0.5), 0), ConvexSet.empty(6, 0), moving(), 0)
    first = model.links(model.gaussians)
    before = first.clone()
    with torch.no_grad():
        model.gaussians.means.mul_(-1)
    assert torch.equal(model.links(model.gaussians), before)
    model.relink()
    assert not torch.equal(model.links(model.gaussians), before)
    assert model.links(model.gaussians) is first, "in the memory that a captured step reads"
    model.gaussians = model.gaussians.select(torch.arange(5))
    assert len(model.links(model.gaussians)) == 5


def test_what_does_not_move_and_corners_of_convexes():
    g = GaussianSet.from_points(rest().points.numpy(), np.full((40, 3), 0.5), 0)
    g.dynamic[:20] = False
    c = ConvexSet.from_points(np.random.default_rng(0).normal(size=(3, 6, 3)), np.full((3, 3), 0.5), 0)
    nodes = steer(some(), [0.0, 0, 0, 0, 1.0, 0, 0])
    gaussians, convexes = Model(g, c, nodes, 0).at(0.5)
    shift = torch.tensor([0.15, 0, 0])
    assert torch.equal(gaussians.means[:20], g.means[:20])
    assert torch.allclose(gaussians.means[20:], g.means[20:] + shift, atol=1e-6)
    assert torch.allclose(convexes.points, c.points + shift, atol=1e-6)


def test_far_from_the_origin_nodes_have_the_same_neighbours_and_spacing():
    """Of more than 25 points torch finds distances by a matrix product, which loses their digits there."""
    positions = some(100).positions
    far = (positions.double() + 2000.0).float()  # exact to 1e-4
    for k, others in enumerate(ControlNodes(far, torch.full((3,), 2000.0), 1.0, 0.5).graph()):
        assert k not in others and set(others.tolist()) == set(((far - far[k]).norm(dim=1)).topk(7, largest=False).indices[1:].tolist())
    assert torch.allclose(spacing(far), spacing(positions), rtol=1e-2)


def test_nodes_spread_anew_keep_the_network():
    nodes = moving()
    again = nodes.spread_over(np.random.default_rng(3).normal(size=(500, 3)))
    assert len(again.positions) == len(nodes.positions) and not torch.equal(again.positions, nodes.positions)
    assert all(a is b for a, b in zip(nodes.network.parameters(), again.network.parameters()))
    assert torch.allclose(again.log_radii, spacing(again.positions).log())


def test_farthest_points():
    line = np.stack([np.linspace(0, 1, 11), np.zeros(11), np.zeros(11)], 1)
    assert sorted(farthest_points(line, 3)[:, 0].tolist()) == pytest.approx([0.0, 0.5, 1.0])
    assert len(farthest_points(np.zeros((4, 3)), 3)) == 1  # no two alike


def test_the_encoding_holds_the_octaves():
    x = torch.tensor([[0.5]])
    expected = [0.5, np.sin(0.5), np.sin(1.0), np.cos(0.5), np.cos(1.0)]
    assert torch.allclose(encode(x, 2)[0], torch.tensor(expected).float())


def test_a_rigid_part_that_turns_and_goes_steadily_costs_nothing():
    angles = torch.linspace(0, 3, 12)
    quats = torch.stack([torch.cos(angles / 2), torch.zeros(12), torch.sin(angles / 2), torch.zeros(12)], 1)
    shifts = torch.linspace(0, 1, 12)[:, None] * torch.tensor([1.0, 2.0, 0])
    home = torch.zeros(3)
    steady = RigidParts.none().joined(home, 1.0, quats, shifts)
    assert float(steady.course(1.0)) < 1e-5
    quats[6] = quats[5]
    assert float(RigidParts.none().joined(home, 1.0, quats, shifts).course(1.0)) > 0.01
    shifts[3] += 0.5
    assert float(RigidParts.none().joined(home, 1.0, quats, shifts).course(1.0)) > 0.1
