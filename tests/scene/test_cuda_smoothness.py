"""The GPU's total variation of planes, on the emulator: against plain float64 torch, and its promises."""

from types import SimpleNamespace

import pytest
import torch
from e4dgs.rasterizer.cuda.runtime import launching
from e4dgs.scene.cuda import smoothness
from e4dgs.scene.cuda.smoothness import total_variation
from e4dgs.scene.motion.planes.hexplane import HexPlanes, smoothness_reference
from simt import CHECKED, RACES, Emulator

pytestmark = pytest.mark.usefixtures("emulated")

# resolutions, times, channels: nothing to differ from, one axis only, rows shorter and longer than a block's piece, seven channels
CASES = [((1,), 1, 4), ((1, 3), 2, 4), ((2,), 3, 64), ((5, 9), 4, 7), ((16, 32), 6, 16), ((16, 5, 33), 1, 32)]


def make(resolutions, times, channels):
    g = torch.Generator().manual_seed(3)
    space = [torch.randn(3, r, r, channels, generator=g).requires_grad_() for r in resolutions]
    return space, [torch.randn(3, times, r, channels, generator=g).requires_grad_() for r in resolutions]


def outcome(launcher, space, time):
    """The value, and the gradients of its triple."""
    value = total_variation(launcher, space, time)
    return [value.detach(), *torch.autograd.grad(3 * value, [*space, *time])]


def exact(space, time):
    """The same by plain torch in float64."""
    space, time = ([p.detach().double().requires_grad_() for p in planes] for planes in (space, time))
    value = smoothness_reference(space, time)
    planes = [*space, *time]
    if not value.requires_grad:
        return [value, *(torch.zeros_like(p) for p in planes)]
    grads = torch.autograd.grad(3 * value, planes, allow_unused=True)
    return [value.detach(), *(torch.zeros_like(p) if g is None else g for g, p in zip(grads, planes))]


def assert_close(found, expected):
    for a, b in zip(found, expected):
        assert a.shape == b.shape and (a - b).norm() <= 2e-6 * b.norm() + 1e-12


@pytest.mark.parametrize(("resolutions", "times", "channels"), CASES)
def test_value_and_gradients_match_float64(resolutions, times, channels):
    planes = make(resolutions, times, channels)
    assert_close(outcome(Emulator(), *planes), exact(*planes))


def test_gradients_are_differences():
    """The value is a square, so that differences over any distance are its derivatives."""
    space, time = make((5, 3), 4, 7)
    for plane, gradient in zip([*space, *time], outcome(Emulator(), space, time)[1:]):
        way = torch.randn(plane.shape, generator=torch.Generator().manual_seed(5))
        ends = []
        with torch.no_grad():
            for step in (way, -2 * way):
                plane += step
                ends.append(float(total_variation(Emulator(), space, time)))
            plane += way
        assert abs(3 * (ends[0] - ends[1]) / 2 - float((gradient * way).sum())) <= 1e-5 * float(gradient.norm() * way.norm())


@pytest.mark.parametrize("emulator", [Emulator(3), Emulator(flags=CHECKED), Emulator(flags=RACES)], ids=["order", "checked", "races"])
def test_any_order_of_threads_gives_the_same_bits(emulator):
    planes = make((5, 9), 4, 7)
    assert all(torch.equal(a, b) for a, b in zip(outcome(emulator, *planes), outcome(Emulator(), *planes)))


def test_a_number_that_is_not_finite_is_seen():
    space, time = make((5,), 4, 8)
    with torch.no_grad():
        space[0][1, 2, 3, 4] = torch.nan
    value, *gradients = outcome(Emulator(), space, time)
    assert bool(value.isnan()) and int(gradients[0].isnan().sum()) == 5 and bool(gradients[1].isfinite().all())


def test_planes_that_lie_across_are_taken():
    space, time = make((5, 9), 4, 7)
    turned = [[p.detach().transpose(1, 2).contiguous().transpose(1, 2).requires_grad_() for p in planes] for planes in (space, time)]
    assert not turned[0][0].is_contiguous()
    assert all(torch.equal(a, b) for a, b in zip(outcome(Emulator(), *turned), outcome(Emulator(), space, time)))


@pytest.mark.parametrize("planes", [[], [torch.ones(2, 4, 4, 8)], [torch.ones(3, 0, 4, 8)], [torch.ones(3, 4, 4, 8).double()]])
def test_what_the_kernels_do_not_take_is_refused(planes):
    with pytest.raises(ValueError, match="planes must be"):
        total_variation(Emulator(), planes, planes)


def test_planes_on_a_gpu_take_the_kernels(monkeypatch):
    """With stand-ins for what lies on a GPU."""
    there, emulator = SimpleNamespace(is_cuda=True, dtype=torch.float32, device=torch.device("cuda", 0)), Emulator()
    monkeypatch.setattr(smoothness, "total_variation", lambda *given: given)
    with launching("cuda", emulator):
        assert HexPlanes.total_variation(SimpleNamespace(space=[there], time=[there])) == (emulator, [there], [there])


@pytest.mark.cuda
@pytest.mark.parametrize(("resolutions", "times", "channels"), CASES)
def test_on_a_gpu_value_and_gradients_match_float64(resolutions, times, channels):
    from e4dgs.rasterizer.cuda.runtime import launcher_for

    planes = make(resolutions, times, channels)
    there = [[p.detach().cuda().requires_grad_() for p in some] for some in planes]
    first, second = (outcome(launcher_for(there[0][0].device), *there) for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(first, second))
    assert_close([p.cpu() for p in first], exact(*planes))
