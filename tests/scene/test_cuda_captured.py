"""Networks of a few times as CUDA graphs, on a GPU, against the same networks operation by operation on the CPU."""

import pytest
import torch
from e4dgs.scene.cuda.over_time import OverTime
from e4dgs.scene.motion.nodes.control_nodes import ControlNodes

TIMES = ([0.2], [0.9], [0.1, 0.4, 0.5, 0.6], [-1.0])


def some_nodes() -> ControlNodes:
    g = torch.Generator().manual_seed(1)
    nodes = ControlNodes(torch.rand(30, 3, generator=g), torch.zeros(3), 1.0, 1.0)
    with torch.no_grad():
        for p in nodes.network.parameters():
            p.add_(0.1 * torch.randn(p.shape, generator=g))
    return nodes


def measured(nodes: ControlNodes) -> list[torch.Tensor]:
    """Of several calls before one backward pass: poses, light and priors, and the gradients of the networks."""
    device = nodes.positions.device
    found = [value for times in TIMES for node in nodes.at_times(times) for value in (node.turns, node.shifts)]
    found += [nodes.light(times[0]) for times in TIMES]
    none = torch.zeros(0, 3, device=device)
    found += [value for t in (0.3, 0.7) for value in nodes.priors(none, none, t, 0.1)]
    loss = sum((value * torch.linspace(0.5, 1, value.numel(), device=device).view_as(value)).sum() for value in found)
    parameters = [*nodes.network.parameters(), *nodes.light.parameters()]
    return [value.detach().cpu() for value in (*found, *torch.autograd.grad(loss, parameters))]


@pytest.mark.cuda
def test_values_and_gradients_are_those_of_the_network_also_after_steps() -> None:
    on_cpu, there = some_nodes(), some_nodes().to("cuda")
    for _ in range(3):
        for got, want in zip(measured(there), measured(on_cpu), strict=True):
            assert (got - want).norm() <= 1e-4 * want.norm() + 1e-7
        with torch.no_grad():
            for nodes in (on_cpu, there):
                for p in nodes.parameters():
                    p.mul_(0.9)


@pytest.mark.cuda
def test_without_gradients_and_on_another_device_it_is_the_same() -> None:
    nodes = some_nodes().to("cuda")
    with torch.no_grad():
        first = nodes.at(0.3).shifts.clone()
        assert torch.equal(nodes.at(0.3).shifts, first) and not torch.equal(nodes.at(0.8).shifts, first)
    assert torch.allclose(nodes.to("cpu").at(0.3).shifts, first.cpu(), atol=1e-5)


def test_times_are_clamped() -> None:
    same = OverTime(lambda times: (times,), lambda: torch.nn.Linear(1, 1).double())
    assert same([-1.0, 0.25, 2.0])[0].tolist() == [0.0, 0.25, 1.0]
