"""The six-plane kernel against plain float64 torch, central differences, and its promises."""

import pytest
import torch
from e4dgs.scene.motion.planes.hexplane import HexPlanes, lookup_reference, smoothness_reference


def make(resolutions=(5, 9), times=4, channels=8):
    planes = HexPlanes(resolutions, times, channels)
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        for p in planes.parameters():
            p.copy_(torch.randn(p.shape, generator=generator))
    return planes


def interleaved(planes, dtype=torch.float64):
    return [p.detach().to(dtype).requires_grad_() for pair in zip(planes.space, planes.time) for p in pair]


@pytest.mark.parametrize("t", [0.0, 0.31, 1 / 3, 1.0, -0.5, 1.5])
@pytest.mark.parametrize("channels", [1, 8, 16, 33])
def test_forward_and_gradients_match_the_float64_oracle(t, channels):
    planes = make(channels=channels)
    u = torch.rand(200, 3, generator=torch.Generator().manual_seed(1)) * 1.4 - 0.2  # some lie outside the box
    out = planes(u, t)
    seed = torch.randn(out.shape, generator=torch.Generator().manual_seed(2))
    ours = torch.autograd.grad(out, [p for pair in zip(planes.space, planes.time) for p in pair], seed)
    exact = interleaved(planes)
    expected = lookup_reference(u.double(), t, *exact)
    theirs = torch.autograd.grad(expected, exact, seed.double())
    assert torch.allclose(out.double(), expected, rtol=1e-5, atol=1e-5)
    for a, b in zip(ours, theirs):
        assert (a - b).norm() <= 1e-5 * b.norm()


def test_oracle_gradients_match_central_differences():
    planes = make((3,), 3, 2)
    u = torch.rand(6, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    assert torch.autograd.gradcheck(lambda *p: lookup_reference(u, 0.4, *p), interleaved(planes), eps=1e-6, atol=1e-8)


def test_time_spans_the_whole_plane():
    """t = 0 and t = 1 read the first and the last sample (the published code reads half of the plane)."""
    planes = make((4,), 5, 2)
    u = torch.full((1, 3), 0.5)
    ends = [planes(u, 0.0).detach(), planes(u, 1.0).detach()]
    middle = planes(u, 0.5).detach()
    with torch.no_grad():
        planes.time[0][:, 1:4] += 10.0
    assert torch.equal(planes(u, 0.0), ends[0]) and torch.equal(planes(u, 1.0), ends[1])
    assert not torch.allclose(planes(u, 0.5), middle)


def test_one_time_and_one_cell_are_allowed():
    planes = HexPlanes((1,), 1, 4)
    out = planes(torch.rand(3, 3), 0.7)
    assert out.shape == (3, 4) and torch.isfinite(out).all() and torch.isfinite(planes.total_variation())


def test_gradients_are_bit_equal_for_any_number_of_threads():
    planes = make((16, 32), 6, 16)
    u = torch.rand(3000, 3, generator=torch.Generator().manual_seed(1))
    before = torch.get_num_threads()
    results = []
    try:
        for threads in (1, 2, 4):
            torch.set_num_threads(threads)
            results.append(torch.autograd.grad(planes(u, 0.3).square().sum(), list(planes.parameters())))
    finally:
        torch.set_num_threads(before)
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other))


@pytest.mark.parametrize(("resolutions", "times"), [((5, 9), 4), ((1, 3), 2), ((2,), 1), ((16, 32), 50)])
def test_smoothness_and_its_gradients_match_the_float64_oracle(resolutions, times):
    planes = make(resolutions, times, 7)
    parameters = [*planes.space, *planes.time]
    value = 3 * planes.total_variation()
    exact = [p.detach().double().requires_grad_() for p in parameters]
    expected = 3 * smoothness_reference(exact[: len(resolutions)], exact[len(resolutions) :])
    assert abs(float(value.detach()) - float(expected.detach())) <= 2e-6 * float(expected.detach())
    theirs = torch.autograd.grad(expected, exact, allow_unused=True)
    for a, b in zip(torch.autograd.grad(value, parameters), theirs):
        assert (a - (0 if b is None else b)).norm() <= 2e-6 * (0 if b is None else float(b.norm())) + 1e-12


def test_smoothness_oracle_matches_central_differences():
    exact = interleaved(make((3,), 4, 2))
    assert torch.autograd.gradcheck(lambda s, t: smoothness_reference([s], [t]), tuple(exact), eps=1e-6, atol=1e-8)
