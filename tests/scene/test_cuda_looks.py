"""The GPU's kernels of what is rendered of primitives, in the emulator: against plain float64 torch, and their promises."""

import pytest
import torch
from composed_looks import OUTPUTS, assert_close, exactly, given, outcome
from e4dgs.scene.cuda.looks import look
from e4dgs.scene.motion.nodes.control_nodes import ControlNodes
from e4dgs.scene.primitives import ConvexSet, GaussianSet
from pretend_cuda import pretending_cuda
from simt import CHECKED, RACES, Emulator

pytestmark = pytest.mark.usefixtures("emulated")


def on(launcher):
    return lambda *rest: look(launcher, *rest)


CASES = [(0, 15, 15), (1, 15, 15), (128, 8, 8), (300, 15, 3), (300, 15, 0), (129, 0, 0)]


@pytest.mark.parametrize("convex", [False, True], ids=["gaussians", "convexes"])
@pytest.mark.parametrize("light", [False, True], ids=["steady", "lit"])
@pytest.mark.parametrize(("n", "stored", "shown"), CASES)
def test_looks_and_their_gradients_match_float64(n, stored, shown, light, convex):
    inputs = given(n, stored, light, convex)
    assert_close(outcome(on(Emulator()), inputs, shown), exactly(inputs, shown))


def test_what_is_not_rendered_gets_no_gradient():
    """So that the optimiser need not look at it."""
    found = outcome(on(Emulator()), given(20, 15, light=False), 0)
    assert found["g_rest"] is None and found["g_shades"] is None
    assert not outcome(on(Emulator()), given(20, 15), 3)["g_rest"][:, 3:].any()


@pytest.mark.parametrize("used", OUTPUTS)
@pytest.mark.parametrize("convex", [False, True], ids=["gaussians", "convexes"])
def test_what_an_output_does_not_depend_on_gets_no_gradient_from_it(used, convex):
    inputs = given(40, 8, convex=convex)
    found, expected = outcome(on(Emulator()), inputs, 8, (used,)), exactly(inputs, 8, (used,))
    assert_close(found, expected)
    assert {name for name, p in found.items() if p is None} == {name for name, p in expected.items() if p is None}


def test_one_of_two_sizes_may_have_a_gradient_alone():
    inputs = given(40, 8, convex=True)
    assert_close(outcome(on(Emulator()), inputs, 8, ("sizes1",)), exactly(inputs, 8, ("sizes1",)))


def test_opacities_near_their_ends_keep_their_slopes():
    inputs = given(9, 0)
    inputs["logits"] = torch.tensor([-120.0, -80, -30, -10, 0, 5, 10, 15, 120])
    found, expected = outcome(on(Emulator()), inputs, 0), exactly(inputs, 0)
    for name in ("opacities", "g_logits"):
        assert torch.allclose(found[name].double(), expected[name], rtol=1e-6, atol=1e-37), name


@pytest.mark.parametrize("emulator", [Emulator(3), Emulator(flags=CHECKED), Emulator(flags=RACES)], ids=["order", "checked", "races"])
def test_any_order_of_threads_gives_the_same_bits(emulator):
    found, expected = (outcome(on(launcher), given(300), 8) for launcher in (emulator, Emulator()))
    assert all(torch.equal(p, expected[name]) for name, p in found.items())


def test_tensors_that_lie_across_others_are_taken():
    inputs = given(40, 8)
    across = {name: torch.stack([p, p], -1)[..., 0] for name, p in inputs.items()}
    found, expected = (outcome(on(Emulator()), one, 8) for one in (across, inputs))
    assert all(torch.equal(p, expected[name]) for name, p in found.items())


WRONG = [
    ("logs", torch.ones(4, 3)),
    ("others", torch.ones(5, 1)),
    ("logits", torch.ones(5, 1)),
    ("dc", torch.ones(5, 3)),
    ("rest", torch.ones(5, 7, 3)),
    ("shades", torch.ones(5, 4)),
    ("light", torch.ones(4)),
    ("rest", torch.ones(5, 8, 3).double()),
]


@pytest.mark.parametrize(("name", "value"), WRONG, ids=str)
def test_what_the_kernels_do_not_take_is_refused(name, value):
    with pytest.raises(ValueError, match="must be"):
        outcome(on(Emulator()), given(5, 8) | {name: value}, 8)


def kinds(device):
    """A set of each kind on a device, whose numbers are not those of a fresh one."""
    draw = torch.Generator().manual_seed(8)
    points = torch.randn(20, 3, generator=draw).numpy()
    gaussians = GaussianSet.from_points(points, 0.5 + 0.1 * points, 2)
    convexes = ConvexSet.from_points(torch.randn(6, 5, 3, generator=draw).numpy(), 0.5 + 0.1 * points[:6], 2)
    gaussians, convexes = (kind.carrying(ControlNodes.attributes) for kind in (gaussians, convexes))
    with torch.no_grad():
        for p in (p for kind in (gaussians, convexes) for p in kind.parameters.values()):
            p += 0.3 * torch.randn(p.shape, generator=draw)
    return gaussians.to(device), convexes.to(device)


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_sets_on_a_gpu_take_the_kernels_and_nothing_waits(degree):
    """More degrees than there are coefficients show them all."""
    light = torch.tensor([0.3, -0.2, 0.9])

    def looks(device):
        for kind, names in zip(kinds(device), (("log_scales",), ("log_tau", "log_kappa"))):
            sizes, opacities, sh = kind.activated(tuple(kind.parameters[name] for name in names), degree, light.to(device))
            sum(p.square().sum() for p in (*sizes, opacities, sh)).backward()
            grads = [p.grad for p in kind.parameters.values() if p.grad is not None]
            yield [*(p.detach() for p in (*sizes, opacities, sh)), *grads]

    expected = list(looks("cpu"))
    with pretending_cuda() as pretending:
        found = list(looks("cuda"))
        assert pretending.kernels == 2 * ["look", "look_backward"]
        assert all(sync.what in ("upload", "to") for sync in pretending.syncs), pretending.syncs
        found = [[p.cpu() for p in one] for one in found]
    for one, other in zip(found, expected, strict=True):
        for p, q in zip(one, other, strict=True):
            torch.testing.assert_close(p, q, rtol=1e-5, atol=1e-6)


@pytest.mark.cuda
@pytest.mark.parametrize("convex", [False, True], ids=["gaussians", "convexes"])
@pytest.mark.parametrize(("n", "stored", "shown"), [*CASES, (100_000, 15, 15)])
def test_on_a_gpu_looks_and_their_gradients_match_float64(n, stored, shown, convex):
    from e4dgs.rasterizer.cuda.runtime import launcher_for

    inputs = given(n, stored, True, convex)
    there = {name: p.cuda() for name, p in inputs.items()}
    first, second = (outcome(on(launcher_for(torch.device("cuda"))), there, shown) for _ in range(2))
    assert all(second[name] is None if p is None else torch.equal(p, second[name]) for name, p in first.items())
    assert_close({name: None if p is None else p.cpu() for name, p in first.items()}, exactly(inputs, shown))
