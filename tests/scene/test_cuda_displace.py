"""The GPU's displacement kernels, on the emulator: against plain float64 torch, and their promises."""

import importlib
from types import SimpleNamespace

import pytest
import torch
from e4dgs.rasterizer.cuda.runtime import launching
from e4dgs.scene.cuda import displace as on_gpu
from e4dgs.scene.cuda.displace import displace
from e4dgs.scene.motion.planes.displace import displace as anywhere
from e4dgs.scene.motion.planes.field import DeformationField
from simt import CHECKED, RACES, Emulator

pytestmark = pytest.mark.usefixtures("emulated")
CENTRE, REACH = torch.tensor([0.3, -0.2, 0.1]), 0.7


def inputs(n):
    """Heads and rest positions, among them quaternions whose norm is zero and nearly so."""
    g = torch.Generator().manual_seed(5)
    heads, rest = torch.randn(n, 10, generator=g), torch.randn(n, 3, generator=g)
    heads[2:3, 3:7] = torch.tensor([-1.0, 0, 0, 0])
    heads[3:4, 3:7] = torch.tensor([-1.0, 0, 3e-7, 0])
    return heads, rest


def outcome(run, heads, rest, used=(0, 1, 2)):
    """The displacement, and the gradients by heads and rest of a sum of its `used` parts with fixed weights."""
    heads, rest = heads.detach().requires_grad_(), rest.detach().requires_grad_()
    out = run(heads, rest, CENTRE.to(heads), REACH)
    g = torch.Generator().manual_seed(6)
    seeds = [torch.randn(part.shape, generator=g).to(heads) for part in out]
    grads = torch.autograd.grad([out[k] for k in used], (heads, rest), [seeds[k] for k in used], allow_unused=True)
    return [*(part.detach() for part in out), *(torch.zeros_like(x) if g is None else g for g, x in zip(grads, (heads, rest)))]


def on(launcher):
    return lambda *given: displace(launcher, *given)


def assert_close(found, expected, leave_out=()):
    """Without the rows of quaternions near zero, of which gradients are huge, and these by themselves."""
    for a, b in zip(found, expected):
        assert a.shape == b.shape and bool(torch.isfinite(a).all())
        keep = [i for i in range(len(a)) if i not in leave_out]
        assert (a - b)[keep].norm() <= 3e-6 * b[keep].norm() + 1e-12
        for i in leave_out[: len(a)]:
            assert (a - b)[i].norm() <= 1e-5 * b[i].norm() + 1e-12


@pytest.mark.parametrize("n", [0, 1, 33, 1000])
@pytest.mark.parametrize("used", [(0, 1, 2), (0,), (1,), (2,), (0, 2)], ids=str)
def test_displacements_and_gradients_match_float64(n, used):
    heads, rest = inputs(n)
    expected = outcome(anywhere, heads.double(), rest.double(), used)
    assert_close(outcome(on(Emulator()), heads, rest, used), expected, leave_out=range(2, 4) if n > 3 else ())


def test_gradients_are_differences():
    heads, rest = inputs(2)
    found = outcome(on(Emulator()), heads, rest)[3:]
    g = torch.Generator().manual_seed(6)
    seeds = [torch.randn(2, k, generator=g).double() for k in (3, 4, 3)]

    def total(*given):
        return sum(float((part.double() * seed).sum()) for part, seed in zip(displace(Emulator(), *given, CENTRE, REACH), seeds))

    step = 2**-7
    for k, (tensor, gradient) in enumerate(zip((heads, rest), found)):
        for at in range(tensor.numel()):
            ends = []
            for sign in (1, -1):
                moved = tensor.clone()
                moved.view(-1)[at] += sign * step
                ends.append(total(moved, rest) if k == 0 else total(heads, moved))
            assert abs((ends[0] - ends[1]) / (2 * step) - float(gradient.view(-1)[at])) <= 2e-3


@pytest.mark.parametrize("wanted", [0, 1], ids=["heads", "rest"])
def test_one_input_alone_may_need_its_gradient(wanted):
    given = inputs(33)
    expected = outcome(on(Emulator()), *given)[3 + wanted]
    given[wanted].requires_grad_()
    out = displace(Emulator(), *given, CENTRE, REACH)
    g = torch.Generator().manual_seed(6)
    (found,) = torch.autograd.grad(list(out), (given[wanted],), [torch.randn(part.shape, generator=g) for part in out])
    assert torch.equal(found, expected)


def test_the_identity_moves_nothing():
    dx, dr, ds = displace(Emulator(), torch.zeros(50, 10), torch.randn(50, 3), CENTRE, REACH)
    assert not dx.any() and not ds.any() and torch.equal(dr, torch.tensor([1.0, 0, 0, 0]).expand(50, 4))


@pytest.mark.parametrize("emulator", [Emulator(3), Emulator(flags=CHECKED), Emulator(flags=RACES)], ids=["order", "checked", "races"])
def test_any_order_of_threads_gives_the_same_bits(emulator):
    heads, rest = inputs(300)
    found, expected = (outcome(on(launcher), heads, rest) for launcher in (emulator, Emulator()))
    assert all(torch.equal(a, b) for a, b in zip(found, expected))


def test_tensors_that_lie_across_others_are_taken():
    heads, rest = inputs(40)
    wide = torch.cat([heads, heads], 1)
    found = outcome(on(Emulator()), wide[:, :10], rest.t().contiguous().t())
    assert all(torch.equal(a, b) for a, b in zip(found, outcome(on(Emulator()), heads, rest)))


@pytest.mark.parametrize(
    ("heads", "rest", "centre"),
    [
        (torch.ones(5, 9), torch.ones(5, 3), CENTRE),
        (torch.ones(4, 10), torch.ones(5, 3), CENTRE),
        (torch.ones(5, 10), torch.ones(5, 4), CENTRE),
        (torch.ones(5, 10), torch.ones(5, 3), torch.ones(1, 3)),
        (torch.ones(5, 10).double(), torch.ones(5, 3), CENTRE),
    ],
)
def test_what_the_kernels_do_not_take_is_refused(heads, rest, centre):
    with pytest.raises(ValueError, match="must be"):
        displace(Emulator(), heads, rest, centre, REACH)


def test_tensors_on_a_gpu_take_the_kernels(monkeypatch):
    """With stand-ins for what lies on a GPU."""
    there, emulator = SimpleNamespace(is_cuda=True, dtype=torch.float32, device=torch.device("cuda", 0)), Emulator()
    asked = []
    monkeypatch.setattr(on_gpu, "displace", lambda *given: asked.append(given) or ("dx", "dr", "ds"))
    with launching("cuda", emulator):
        moved = importlib.import_module("e4dgs.scene.motion.planes.displace").displace(there, there, there, 0.5)
    assert asked == [(emulator, there, there, there, 0.5)] and moved == ("dx", "dr", "ds")


def test_the_fields_reach_follows_its_box():
    """It is a number that is computed where the box may have changed."""
    box = torch.tensor([-1.0, 0.1, 2]), torch.tensor([1.0, 3, 2.7])
    field = DeformationField(*box, 3, (4,), 4, 8)
    expected = 0.25 * float((field.high - field.low).norm())
    assert field.reach == expected and isinstance(field.reach, float)
    other = DeformationField(torch.zeros(3), torch.ones(3), 3, (4,), 4, 8)
    assert other.reach != expected
    other.load_state_dict(field.state_dict())
    assert other.reach == expected and DeformationField.from_state(field.state_dict(), field.config).reach == expected
    assert other.double().reach == 0.25 * float((other.high - other.low).norm()) != expected


@pytest.mark.cuda
def test_on_a_gpu_displacements_and_gradients_match_float64():
    from e4dgs.rasterizer.cuda.runtime import launcher_for

    heads, rest = inputs(1000)
    found = outcome(on(launcher_for(torch.device("cuda"))), heads.cuda(), rest.cuda())
    assert_close([p.cpu() for p in found], outcome(anywhere, heads.double(), rest.double()), leave_out=range(2, 4))
