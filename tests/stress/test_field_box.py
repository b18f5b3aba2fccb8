"""The deformation field with boxes, positions and times that a capture should not have and some have."""

import math

import pytest
import torch
from e4dgs.scene.motion.planes.field import DeformationField
from e4dgs.scene.motion.planes.hexplane import HexPlanes, lookup_reference
from torch import Tensor

BOXES = {
    "a point": ([0.3, -0.2, 1.0], [0.3, -0.2, 1.0]),
    "a point at the origin": ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
    "a line": ([0.0, 1.0, 1.0], [5.0, 1.0, 1.0]),
    "a plane": ([-2.0, -2.0, 3.0], [2.0, 2.0, 3.0]),
    "tiny": ([0.0, 0.0, 0.0], [1e-20, 1e-20, 1e-20]),
    "huge": ([-1e12, -1e12, -1e12], [1e12, 1e12, 1e12]),
    "far and thin": ([1e6, 1e6, 1e6], [1e6 + 1, 1e6 + 1e-3, 1e6]),
}
TIMES = [0.0, 0.5, 1.0, -0.5, 1.5, -1e30, 1e30]


def trained(low: list[float], high: list[float], times: int) -> DeformationField:
    """A field that moves things: heads start at zero, so they are filled."""
    field = DeformationField(torch.tensor(low), torch.tensor(high), times, resolutions=(4, 8), channels=4, width=16)
    with torch.no_grad():
        g = torch.Generator().manual_seed(1)
        field.head.weight.copy_(0.1 * torch.randn(field.head.weight.shape, generator=g))
        for plane in field.planes.time:
            plane.copy_(torch.rand(plane.shape, generator=g) + 0.5)
    return field


def positions(low: list[float], high: list[float]) -> Tensor:
    """Inside, on the corners, a little and far outside."""
    a, b = torch.tensor(low), torch.tensor(high)
    inside = a + (b - a) * torch.rand(20, 3, generator=torch.Generator().manual_seed(2))
    return torch.cat([inside, a[None], b[None], (a - (b - a))[None], (b + 1.0)[None], (a - 1e6)[None]])


@pytest.mark.parametrize("times", [1, 2, 7])
@pytest.mark.parametrize("box", BOXES.values(), ids=BOXES.keys())
def test_flat_and_huge_boxes_points_outside_and_times_outside_0_1(box: tuple[list[float], list[float]], times: int) -> None:
    field, rest = trained(*box, times), positions(*box)
    for t in TIMES:
        field.zero_grad()
        moved = field(rest, t)
        for part in moved:
            assert bool(torch.isfinite(part).all()), t
            assert part.shape[0] == len(rest)
        torch.stack([part.square().mean() for part in moved]).sum().backward()
        for name, parameter in field.named_parameters():
            assert parameter.grad is not None and bool(torch.isfinite(parameter.grad).all()), (t, name)
        assert bool(torch.isfinite(field.regulariser()))


def test_times_outside_0_1_are_the_ends() -> None:
    field = trained([-1.0, -1, -1], [1.0, 1, 1], 5)
    rest = positions([-1.0, -1, -1], [1.0, 1, 1])
    first, last = (tuple(field(rest, t)) for t in (0.0, 1.0))
    assert not torch.equal(first[0], last[0])
    for t, want in ((-3.0, first), (-math.inf, first), (2.0, last), (math.inf, last)):
        assert all(torch.equal(a, b) for a, b in zip(field(rest, t), want)), t


def test_with_one_frame_nothing_depends_on_time() -> None:
    field = trained([-1.0, -1, -1], [1.0, 1, 1], 1)
    rest = positions([-1.0, -1, -1], [1.0, 1, 1])
    want = tuple(field(rest, 0.0))
    assert bool(want[0].any())
    for t in TIMES:
        assert all(torch.equal(a, b) for a, b in zip(field(rest, t), want)), t


def test_points_outside_the_box_are_at_its_faces() -> None:
    """Of the look-up; the kernel against the float64 reference, up to infinity."""
    planes = HexPlanes((4, 8), 3, 4)
    inside = torch.tensor([[0.0, 0.2, 1.0], [1.0, 1.0, 0.4], [0.7, 0.0, 0.0]])
    for far in (0.1, 1e6, 1e30, math.inf):
        outside = torch.where(inside == 0, -far, torch.where(inside == 1, 1 + far, inside))
        assert torch.equal(planes(outside, 0.3), planes(inside, 0.3)), far
    exact = [p.detach().double() for pair in zip(planes.space, planes.time) for p in pair]
    assert torch.allclose(planes(inside, 0.3).double(), lookup_reference(inside.double(), 0.3, *exact), atol=1e-5)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_one_position_that_is_not_finite_stays_inside_the_planes(bad: float) -> None:
    """Its index must not lie outside (NaN once did), and it touches no other position's features nor their share of the gradient."""
    planes = HexPlanes((4, 8), 3, 4)
    u = torch.rand(9, 3, generator=torch.Generator().manual_seed(3))
    poisoned, grad = u.clone(), torch.ones(9, 8)
    poisoned[4, 1], grad[4] = bad, 0.0
    others = torch.arange(9) != 4
    parameters = list(planes.parameters())
    want, got = planes(u, 0.3), planes(poisoned, 0.3)
    assert torch.equal(got[others], want[others]) and bool(torch.isfinite(got).all())
    for a, b in zip(torch.autograd.grad(got, parameters, grad), torch.autograd.grad(want, parameters, grad)):
        assert torch.equal(a, b)
    exact = [p.detach().double() for pair in zip(planes.space, planes.time) for p in pair]
    assert torch.allclose(got.double(), lookup_reference(poisoned.double(), 0.3, *exact), atol=1e-5)


def test_a_time_that_is_not_a_number_stays_inside_the_planes() -> None:
    planes = HexPlanes((4,), 3, 4)
    u = torch.rand(5, 3, generator=torch.Generator().manual_seed(3))
    assert torch.equal(planes(u, math.nan), planes(u, 0.0))
