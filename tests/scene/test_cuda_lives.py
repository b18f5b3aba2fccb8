"""The GPU's kernels of lives, on the emulator: against plain float64 torch, and their promises."""

import pytest
import torch
from e4dgs.scene.cuda.lives import at_frame
from e4dgs.scene.motion.lifetimes.at_frame import at_frame as anywhere
from e4dgs.scene.motion.lifetimes.at_frame import at_frame_reference
from e4dgs.scene.motion.lifetimes.lifetime import Lifetime
from pretend_cuda import pretending_cuda
from simt import CHECKED, RACES, Emulator

pytestmark = pytest.mark.usefixtures("emulated")

FRAME = 4.2
LIMIT = 1e-5  # of the largest number of each result


def given(n, corners=1, with_quats=True, still=0.3, at_once=False):
    """Named float32 inputs and which are dynamic (all but about a share of ``still``); of the turns, every fifth is none and every fifth
    small; some quaternions are zero. With ``at_once``, all points are one."""
    draw = torch.Generator().manual_seed(3)

    def normal(*shape):
        return torch.randn(*shape, generator=draw)

    sizes = torch.tensor([0.0, 1e-3, 0.3, 0.3, 1.5])[torch.arange(n) % 5][:, None]
    inputs = {
        "points": normal(n, corners, 3),
        "opacities": torch.rand(n, generator=draw),
        "times": 8 * torch.rand(n, generator=draw),
        "log_spans": torch.rand(n, generator=draw),
        "velocities": normal(n, 3),
        "spins": sizes * normal(n, 3),
        "quats": normal(n, 4) * (torch.arange(n) % 7 > 0)[:, None],
    }
    if at_once:
        inputs["points"] = torch.full((n, corners, 3), 0.5)
    if not with_quats:
        del inputs["quats"]
    return inputs, torch.rand(n, generator=draw) >= still


def outcome(run, inputs, dynamic, used=("moved", "shown", "turned")):
    """Outputs, and the gradients of a sum of those in ``used`` with fixed weights; missing ones are zero."""
    leaves = {name: p.detach().clone().requires_grad_() for name, p in inputs.items()}
    life = Lifetime(*(leaves[name] for name in Lifetime._fields))
    moved, turned, shown = run(leaves["points"], leaves.get("quats"), leaves["opacities"], life, dynamic, FRAME)
    outputs = {name: p for name, p in (("moved", moved), ("shown", shown), ("turned", turned)) if p is not None}
    draw = torch.Generator().manual_seed(6)
    weights = {name: torch.randn(p.shape, generator=draw).to(p) for name, p in outputs.items()}
    chosen = [name for name in used if name in outputs]
    found = torch.autograd.grad([outputs[k] for k in chosen], list(leaves.values()), [weights[k] for k in chosen], allow_unused=True)
    grads = {f"g_{name}": torch.zeros_like(p) if g is None else g for (name, p), g in zip(leaves.items(), found)}
    return {name: p.detach() for name, p in outputs.items()} | grads


def on(launcher):
    return lambda *rest: at_frame(launcher, *rest)


def exactly(inputs, dynamic, used=("moved", "shown", "turned")):
    return outcome(at_frame_reference, {name: p.double() for name, p in inputs.items()}, dynamic, used)


def assert_close(found, expected):
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        assert found[name].shape == value.shape and found[name].dtype == torch.float32, name
        if value.numel():
            assert float((found[name].double() - value).abs().max()) <= LIMIT * float(1e-3 + value.abs().max()), name


CASES = [(0, 1, True), (0, 6, False), (1, 1, True), (1, 6, False), (300, 1, True), (300, 1, False), (200, 6, False), (200, 3, True)]


@pytest.mark.parametrize(("n", "corners", "with_quats"), CASES)
def test_what_is_alive_and_its_gradients_match_float64(n, corners, with_quats):
    one = given(n, corners, with_quats)
    assert_close(outcome(on(Emulator()), *one), exactly(*one))


@pytest.mark.parametrize("used", [("moved",), ("shown",), ("turned",), ("moved", "shown"), ("shown", "turned")], ids="-".join)
@pytest.mark.parametrize("corners", [1, 4])
def test_outputs_without_a_gradient_count_as_zero(used, corners):
    one = given(100, corners)
    assert_close(outcome(on(Emulator()), *one, used), exactly(*one, used))


@pytest.mark.parametrize("angle", [1e-6, 1e-4, 0.0999, 0.1001, 0.5, 3.0, 12.0])
@pytest.mark.parametrize("corners", [1, 4])
def test_turns_of_any_size_have_exact_gradients(angle, corners):
    """Around the half angle of 0.1 the kernel changes from a series to sines and cosines."""
    inputs, dynamic = given(40, corners)
    inputs["times"] = torch.full((40,), FRAME - 1)
    inputs["spins"] = 2 * angle * torch.nn.functional.normalize(torch.randn(40, 3, generator=torch.Generator().manual_seed(2)), dim=1)
    assert_close(outcome(on(Emulator()), inputs, dynamic), exactly(inputs, dynamic))


@pytest.mark.parametrize(("corners", "still"), [(1, 2.0), (6, 2.0), (1, 0.0), (6, 0.0)])
def test_all_or_none_may_be_dynamic(corners, still):
    inputs, dynamic = given(70, corners, still=still)
    found = outcome(on(Emulator()), inputs, dynamic)
    assert_close(found, exactly(inputs, dynamic))
    if still > 1:
        assert not dynamic.any() and not any(found[f"g_{name}"].any() for name in Lifetime._fields)
        assert all(torch.equal(found[a], inputs[b]) for a, b in (("moved", "points"), ("turned", "quats"), ("shown", "opacities")))


def test_what_is_not_dynamic_may_have_any_life():
    inputs, dynamic = given(70, 4)
    for name in Lifetime._fields:
        inputs[name][~dynamic] = torch.nan
    found = outcome(on(Emulator()), inputs, dynamic)
    assert all(bool(p.isfinite().all()) for p in found.values()) and not any(
        found[f"g_{name}"][~dynamic].any() for name in Lifetime._fields
    )


def test_numbers_that_are_not_finite_stay_with_their_primitive():
    inputs, dynamic = given(40, 3, still=0.0)
    inputs["spins"][3], inputs["log_spans"][7], inputs["times"][11] = torch.nan, -torch.inf, torch.inf
    others = torch.ones(40, dtype=torch.bool)
    others[[3, 7, 11]] = False
    for name, p in outcome(on(Emulator()), inputs, dynamic).items():
        assert bool(p[others].isfinite().all()), name


def test_corners_may_all_be_one():
    one = given(50, 5, at_once=True)
    assert_close(outcome(on(Emulator()), *one), exactly(*one))


@pytest.mark.parametrize("corners", [1, 6])
@pytest.mark.parametrize("emulator", [Emulator(3), Emulator(flags=CHECKED), Emulator(flags=RACES)], ids=["order", "checked", "races"])
def test_any_order_of_threads_gives_the_same_bits(emulator, corners):
    one = given(300, corners)
    found, expected = (outcome(on(launcher), *one) for launcher in (emulator, Emulator()))
    assert all(torch.equal(p, expected[name]) for name, p in found.items())


def test_tensors_that_lie_across_others_are_taken():
    inputs, dynamic = given(40, 4)
    across = {name: torch.stack([p, p], -1)[..., 0] for name, p in inputs.items()}
    life = Lifetime(*(across[name] for name in Lifetime._fields))
    found = at_frame(
        Emulator(), across["points"], across["quats"], across["opacities"], life, torch.stack([dynamic, dynamic], 1)[:, 0], FRAME
    )
    expected = outcome(on(Emulator()), inputs, dynamic)
    assert all(torch.equal(p, expected[name]) for name, p in zip(("moved", "turned", "shown"), found))


WRONG = [
    ("points", torch.ones(5, 3)),
    ("points", torch.ones(5, 0, 3)),
    ("points", torch.ones(4, 2, 3)),
    ("quats", torch.ones(5, 3)),
    ("times", torch.ones(5, 1)),
    ("spins", torch.ones(5, 4)),
    ("velocities", torch.ones(5, 3).double()),
]


@pytest.mark.parametrize(("name", "value"), WRONG)
def test_what_the_kernels_do_not_take_is_refused(name, value):
    inputs, dynamic = given(5)
    with pytest.raises(ValueError, match="must be"):
        outcome(on(Emulator()), inputs | {name: value}, dynamic)


@pytest.mark.parametrize("dynamic", [torch.ones(5), torch.ones(4, dtype=torch.bool)])
def test_flags_of_another_kind_are_refused(dynamic):
    with pytest.raises(ValueError, match="must be"):
        outcome(on(Emulator()), given(5)[0], dynamic)


def test_tensors_on_a_gpu_take_the_kernels_and_nothing_waits():
    inputs, dynamic = given(33)
    expected = outcome(on(Emulator()), inputs, dynamic)
    with pretending_cuda() as pretending:
        there = {name: p.cuda() for name, p in inputs.items()}, dynamic.cuda()
        pretending.syncs.clear()
        found = outcome(anywhere, *there)
        assert pretending.kernels == ["live", "live_backward"] and all(sync.what == "upload" for sync in pretending.syncs)
        assert all(torch.equal(p.cpu(), expected[name]) for name, p in found.items())
        exact = outcome(anywhere, {name: p.double() for name, p in there[0].items()}, there[1])
        assert exact["moved"].dtype == torch.float64 and len(pretending.kernels) == 2


@pytest.mark.cuda
@pytest.mark.parametrize(("n", "corners", "with_quats"), CASES)
def test_on_a_gpu_what_is_alive_and_its_gradients_match_float64(n, corners, with_quats):
    from e4dgs.rasterizer.cuda.runtime import launcher_for

    inputs, dynamic = given(n, corners, with_quats)
    there = {name: p.cuda() for name, p in inputs.items()}, dynamic.cuda()
    first, second = (outcome(on(launcher_for(torch.device("cuda"))), *there) for _ in range(2))
    assert all(torch.equal(p, second[name]) for name, p in first.items())
    assert_close({name: p.cpu() for name, p in first.items()}, exactly(inputs, dynamic))
