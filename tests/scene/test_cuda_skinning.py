"""The GPU's kernels of skinning, on the emulator: against plain float64 torch, and their promises."""

import numpy as np
import pytest
import torch
from deterministic import deterministic
from e4dgs.scene.cuda.skinning import nearest_nodes, skin
from e4dgs.scene.motion.nodes.nodes import Nodes
from e4dgs.scene.motion.nodes.skinning import nearest_nodes as nearest_anywhere
from e4dgs.scene.motion.nodes.skinning import skin as skin_anywhere
from e4dgs.scene.motion.nodes.skinning import skin_reference
from pretend_cuda import pretending_cuda
from simt import CHECKED, RACES, Emulator

pytestmark = pytest.mark.usefixtures("emulated")

LIMIT = 5e-6  # of the largest number of each result
OWN = ("points", "quats", "hyper")


def scene(n=300, nodes=25, links=4, hyper=2, offset=0.0, apart=1.0):
    """Named float32 inputs: points, of which some quaternions are zero, nodes, and links to the nearest, in runs that share them."""
    draw = torch.Generator().manual_seed(3)

    def normal(*shape):
        return torch.randn(*shape, generator=draw)

    turns = torch.nn.functional.normalize(torch.tensor([1.0, 0, 0, 0]) + 0.8 * normal(nodes, 4), dim=1)
    there = Nodes(apart * normal(nodes, 3) + offset, 0.2 * normal(nodes, hyper), 2 + normal(nodes).abs() * 5, turns, 0.3 * normal(nodes, 3))
    points = apart * normal(n, 3)
    points = points[points[:, 0].argsort()] + offset
    quats = normal(n, 4) * (torch.arange(n) % 9 > 0)[:, None]
    inputs = {"points": points, "quats": quats, "hyper": 0.2 * normal(n, hyper), **there._asdict()}
    return inputs, exact_links(inputs, links)


def exact_links(inputs, links):
    places = [torch.cat(pair, 1).double() for pair in ((inputs["points"], inputs["hyper"]), (inputs["home"], inputs["home_hyper"]))]
    weighed = (places[0][:, None] - places[1]).square().sum(2) * inputs["falloff"].double()
    return weighed.sort(dim=1, stable=True).indices[:, :links].int()


def nodes_of(inputs):
    return Nodes(*(inputs[name] for name in Nodes._fields))


def outcome(run, inputs, link, used=("moved", "turned"), seen=None):
    """Outputs, and the gradients of a sum of those in ``used``, of rows ``seen``, with fixed weights."""
    leaves = {name: p.detach().clone().requires_grad_() for name, p in inputs.items()}
    outputs = dict(zip(("moved", "turned"), run(*(leaves[name] for name in OWN), link, nodes_of(leaves))))
    draw = torch.Generator().manual_seed(6)
    weights = {name: torch.randn(p.shape, generator=draw).to(p) for name, p in outputs.items()}
    if seen is not None:
        weights = {name: p * seen[:, None] for name, p in weights.items()}
    found = torch.autograd.grad([outputs[k] for k in used], list(leaves.values()), [weights[k] for k in used], allow_unused=True)
    grads = {f"g_{name}": torch.zeros_like(p) if g is None else g for (name, p), g in zip(leaves.items(), found)}
    return {name: p.detach() for name, p in outputs.items()} | grads


def on(launcher):
    return lambda *rest: skin(launcher, *rest)


def exactly(inputs, link, **options):
    return outcome(skin_reference, {name: p.double() for name, p in inputs.items()}, link, **options)


def assert_close(found, expected, limit=LIMIT):
    assert found.keys() == expected.keys() and not found["g_home"].any()
    for name, value in expected.items():
        assert found[name].shape == value.shape and found[name].dtype == torch.float32, name
        if value.numel():
            assert float((found[name].double() - value).abs().max()) <= limit * float(1e-3 + value.abs().max()), name


# points, nodes, links, hyper: none, one node, fewer points than a warp, as many nodes as links, more points than a block
CASES = [(0, 5, 4, 2), (1, 1, 1, 2), (300, 1, 1, 2), (20, 3, 3, 0), (63, 4, 4, 4), (300, 25, 4, 2), (200, 40, 8, 1), (1000, 3, 3, 3)]


@pytest.mark.parametrize("in_order", [False, True], ids=["atomic", "deterministic"])
@pytest.mark.parametrize("sizes", CASES, ids=str)
def test_what_is_carried_and_its_gradients_match_float64(sizes, in_order):
    given = scene(*sizes)
    with deterministic() if in_order else torch.enable_grad():
        found = outcome(on(Emulator()), *given)
    assert_close(found, exactly(*given))


def test_after_an_emulated_launch_x87_code_still_works():
    """OpenBLAS has some in its singular value decomposition: it gives NaN while an MMX register is in use."""
    outcome(on(Emulator()), *scene(63, 4, 4, 4))
    matrix = np.random.default_rng(0).normal(size=(3, 3))
    u, s, v = np.linalg.svd(matrix)
    assert np.allclose(u * s @ v, matrix, atol=1e-12)


@pytest.mark.parametrize("used", [("moved",), ("turned",)], ids=str)
def test_outputs_without_a_gradient_count_as_zero(used):
    given = scene(100)
    assert_close(outcome(on(Emulator()), *given, used), exactly(*given, used=used))


@pytest.mark.parametrize("share", [2, 7, 1000])
def test_points_without_a_gradient_take_no_part(share):
    inputs, link = scene(300)
    seen = torch.arange(300) % share == 1
    found = outcome(on(Emulator()), inputs, link, seen=seen)
    assert_close(found, exactly(inputs, link, seen=seen))
    assert not any(found[f"g_{name}"][~seen].any() for name in OWN)
    with deterministic():
        assert_close(outcome(on(Emulator()), inputs, link, seen=seen), exactly(inputs, link, seen=seen))


@pytest.mark.parametrize("column", range(7))
def test_a_gradient_of_one_number_alone_is_not_overlooked(column):
    inputs, link = scene(40)

    def alone(run, given):
        leaf = given["points" if column < 3 else "turns"].clone().requires_grad_()
        given = given | {"points" if column < 3 else "turns": leaf}
        outputs = torch.cat(run(*(given[name] for name in OWN), link, nodes_of(given)), 1)
        return torch.autograd.grad(outputs, leaf, torch.eye(7)[column].to(outputs).expand(40, 7))[0]

    exact = alone(skin_reference, {name: p.double() for name, p in inputs.items()})
    assert exact.any() and float((alone(on(Emulator()), inputs) - exact).abs().max()) <= LIMIT * float(exact.abs().max())


def test_gradients_that_are_not_numbers_are_seen():
    inputs, link = scene(100)
    seen = torch.zeros(100)
    seen[7] = torch.nan
    found = outcome(on(Emulator()), inputs, link, seen=seen)
    hit = torch.zeros(25, dtype=torch.bool)
    hit[link[7].long()] = True
    assert bool(found["g_points"][7].isnan().all()) and bool(found["g_shifts"][hit].isnan().all())
    assert not found["g_points"][:7].any() and not found["g_shifts"][~hit].any()


@pytest.mark.parametrize("apart", [0.0, 1e-4])
def test_all_may_lie_at_one_place(apart):
    given = scene(200, apart=apart)
    assert_close(outcome(on(Emulator()), *given), exactly(*given))


def test_turns_that_cancel_or_vanish_have_finite_gradients():
    inputs, link = scene(100, 6)
    inputs["turns"][:3] = 0
    inputs["turns"][3] *= -1
    given = inputs, link
    assert_close(outcome(on(Emulator()), *given, ("moved",)), exactly(*given, used=("moved",)))
    assert all(bool(p.isfinite().all()) for p in outcome(on(Emulator()), *given).values())


def test_far_from_the_origin_nothing_is_lost():
    given = scene(offset=1024.0)
    found, expected = outcome(on(Emulator()), *given), exactly(*given)
    assert float((found["moved"] - expected["moved"]).abs().max()) <= 1.3e-4  # positions are rounded to 6e-5 there
    del found["moved"], expected["moved"]
    assert_close(found, expected)


@pytest.mark.parametrize("emulator", [Emulator(flags=CHECKED), Emulator(flags=RACES)], ids=["checked", "races"])
@pytest.mark.parametrize("sizes", [(300, 25, 4, 2), (150, 2, 2, 0), (70, 30, 8, 4)], ids=str)
def test_nothing_is_read_or_written_out_of_turn(emulator, sizes):
    given = scene(*sizes)
    assert_close(outcome(on(emulator), *given), exactly(*given))
    with deterministic():
        found, expected = (outcome(on(launcher), *given) for launcher in (emulator, Emulator()))
    assert all(torch.equal(p, expected[name]) for name, p in found.items())


def test_any_order_of_threads_gives_the_same_within_rounding():
    given = scene(1000)
    first, *others = (outcome(on(Emulator(seed)), *given) for seed in range(4))
    assert any(not torch.equal(p, first[name]) for other in others for name, p in other.items())  # orders do differ
    for other in others:
        assert all(torch.equal(other[name], first[name]) for name in ("moved", "turned", "g_points", "g_quats", "g_hyper"))
        assert_close(other, first, 2e-6)


def test_deterministic_sums_have_the_same_bits_in_any_order_of_threads():
    given = scene(1000)
    with deterministic():
        first, *others = (outcome(on(Emulator(seed)), *given) for seed in range(4))
    assert all(torch.equal(p, first[name]) for other in others for name, p in other.items())
    assert_close(first, exactly(*given))


def test_tensors_that_lie_across_others_are_taken():
    inputs, link = scene(60)
    across = {name: torch.stack([p, p], -1)[..., 0] for name, p in inputs.items()}
    with deterministic():
        expected = outcome(on(Emulator()), inputs, link)
        leaves = {name: p.requires_grad_() for name, p in across.items()}
        link = link.t().contiguous().t()
        found = skin(Emulator(), *(leaves[name] for name in OWN), link, nodes_of(leaves))
    assert all(torch.equal(p, expected[name]) for name, p in zip(("moved", "turned"), found))
    near = nearest_nodes(Emulator(), across["points"], across["hyper"], nodes_of(across), 4)
    assert torch.equal(near, nearest_nodes(Emulator(), inputs["points"], inputs["hyper"], nodes_of(inputs), 4))


EVERY_WAY = {"plain": Emulator(), "order": Emulator(3), "checked": Emulator(flags=CHECKED), "races": Emulator(flags=RACES)}


@pytest.mark.parametrize("emulator", EVERY_WAY.values(), ids=EVERY_WAY.keys())
@pytest.mark.parametrize("sizes", [(0, 5, 4, 2), (1, 1, 1, 0), (300, 128, 4, 2), (130, 129, 4, 2), (200, 300, 8, 4)], ids=str)
def test_the_nearest_nodes_are_found(emulator, sizes):
    inputs, link = scene(*sizes)
    found = nearest_nodes(emulator, inputs["points"], inputs["hyper"], nodes_of(inputs), sizes[2])
    assert found.dtype == torch.int32 and torch.equal(found, link)


def test_between_nodes_that_are_equally_near_it_decides_as_the_cpu_does():
    """Nodes and points on a grid of small whole numbers, where nothing is rounded."""
    draw = torch.Generator().manual_seed(2)
    points, hyper, home, home_hyper = (torch.randint(0, 3, (n, m), generator=draw).float() for n in (200, 150) for m in (3, 2))
    nodes = Nodes(home, home_hyper, torch.ones(150), torch.zeros(0), torch.zeros(0))
    assert torch.equal(nearest_nodes(Emulator(), points, hyper, nodes, 4), nearest_anywhere(points, hyper, nodes, 4))


def test_fewer_nodes_than_links_are_all_taken_and_bad_points_take_the_first():
    inputs, _ = scene(10, 3)
    inputs["points"][4] = torch.nan
    found = nearest_nodes(Emulator(), inputs["points"], inputs["hyper"], nodes_of(inputs), 4)
    assert found.shape == (10, 3) and not found[4].any()
    assert torch.equal(found, nearest_anywhere(inputs["points"], inputs["hyper"], nodes_of(inputs), 4))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("points", torch.ones(8, 4)),
        ("quats", torch.ones(7, 4)),
        ("hyper", torch.ones(8, 5)),
        ("hyper", torch.ones(8, 1)),
        ("turns", torch.ones(5, 3)),
        ("falloff", torch.ones(5, 1)),
        ("shifts", torch.ones(5, 3).double()),
        ("link", torch.zeros(8, 9, dtype=torch.int32)),
        ("link", torch.zeros(7, 4, dtype=torch.int32)),
        ("link", torch.zeros(8, 4, dtype=torch.int64)),
    ],
)
def test_what_the_kernels_do_not_take_is_refused(name, value):
    inputs, link = scene(8, 5)
    inputs, link = (inputs, value) if name == "link" else (inputs | {name: value}, link)
    with pytest.raises(ValueError, match=f"{name} must be|hyper must be"):
        skin(Emulator(), *(inputs[own] for own in OWN), link, nodes_of(inputs))


@pytest.mark.parametrize(("nodes", "count"), [(0, 4), (20, 9), (20, 0)])
def test_a_search_without_nodes_or_for_too_many_is_refused(nodes, count):
    inputs, _ = scene(8, nodes)
    with pytest.raises(ValueError, match="must be"):
        nearest_nodes(Emulator(), inputs["points"], inputs["hyper"], nodes_of(inputs), count)


@pytest.mark.parametrize("in_order", [False, True], ids=["atomic", "deterministic"])
def test_tensors_on_a_gpu_take_the_kernels_and_nothing_waits(in_order):
    inputs, link = scene(70)
    with deterministic() if in_order else torch.enable_grad():
        expected = outcome(on(Emulator()), inputs, link)
        with pretending_cuda() as pretending:
            there = {name: p.cuda() for name, p in inputs.items()}
            found_link = nearest_anywhere(there["points"], there["hyper"], nodes_of(there), 4)
            pretending.syncs.clear()
            found = outcome(skin_anywhere, there, found_link)
            assert pretending.kernels == ["nearest_nodes", "skin", "skin_backward", *["sum_links"] * in_order]
            assert all(sync.what == "upload" for sync in pretending.syncs)  # of the test's own weights
            assert torch.equal(found_link.cpu(), link) and all(torch.equal(p.cpu(), expected[name]) for name, p in found.items())
            exact = outcome(skin_anywhere, {name: p.double() for name, p in there.items()}, found_link)
            assert exact["moved"].dtype == torch.float64 and pretending.kernels.count("skin") == 1


@pytest.mark.cuda
@pytest.mark.parametrize("in_order", [False, True], ids=["atomic", "deterministic"])
@pytest.mark.parametrize("sizes", [*CASES, (20000, 600, 4, 2)], ids=str)
def test_on_a_gpu_what_is_carried_and_its_gradients_match_float64(sizes, in_order):
    from e4dgs.rasterizer.cuda.runtime import launcher_for

    inputs, link = scene(*sizes)
    there, launcher = {name: p.cuda() for name, p in inputs.items()}, launcher_for(torch.device("cuda"))
    near = nearest_nodes(launcher, there["points"], there["hyper"], nodes_of(there), sizes[2]).cpu()
    assert float((near == link).float().mean() if link.numel() else 1) > 0.999  # rounding decides between two that are equally near
    with deterministic() if in_order else torch.enable_grad():
        first, second = (outcome(on(launcher), there, link.cuda()) for _ in range(2))
    if in_order:
        assert all(torch.equal(p, second[name]) for name, p in first.items())
    assert_close({name: p.cpu() for name, p in first.items()}, exactly(inputs, link), 3e-5)
