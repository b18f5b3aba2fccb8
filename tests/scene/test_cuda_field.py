"""The GPU's six-plane look-up, on the emulator: against plain float64 torch, and its promises."""

import math
from types import SimpleNamespace

import pytest
import torch
from deterministic import deterministic
from e4dgs.rasterizer.cuda.runtime import launching
from e4dgs.scene.cuda import field
from e4dgs.scene.cuda.field import look_up
from e4dgs.scene.motion.planes import field_kernel
from e4dgs.scene.motion.planes.field import DeformationField
from e4dgs.scene.motion.planes.field_reference import lookup_reference
from simt import CHECKED, RACES, Emulator

pytestmark = pytest.mark.usefixtures("emulated")

BOX = torch.tensor([-1.0, 0, 2]), torch.tensor([1.0, 3, 2.5])
# channels, resolutions, times, points: every number of levels, groups of 1 to 16 lanes, one sample alone, and (the last) lines that no
# block's memory holds. Few different ones, since each is compiled.
CASES = [
    (4, (5,), 1, 33),
    (12, (1, 3), 2, 1),
    (16, (5, 9), 6, 1000),
    (16, (5, 9), 3, 0),
    (32, (7, 5, 9), 2, 33),
    (64, (1, 6, 3, 50), 3, 50),
]


def make(channels, resolutions, times, seed=3):
    """Space and time planes of each level."""
    g = torch.Generator().manual_seed(seed)
    space = [torch.randn(3, r, r, channels, generator=g).requires_grad_() for r in resolutions]
    return space, [torch.randn(3, times, r, channels, generator=g).requires_grad_() for r in resolutions]


def positions(n):
    """Some outside the box, some on its faces, some not finite."""
    u = torch.rand(n, 3, generator=torch.Generator().manual_seed(1)) * 1.4 - 0.2
    for k, value in enumerate((math.nan, math.inf, -math.inf, 0.0, 1.0)):
        u[3 * k + 2 : 3 * k + 3, k % 3] = value
    return BOX[0] + (BOX[1] - BOX[0]) * u


def outcome(launcher, space, time, points, box, t):
    """Features, and the gradients of a sum of them with fixed weights."""
    out = look_up(launcher, space, time, points, box, t)
    seed = torch.randn(out.shape, generator=torch.Generator().manual_seed(2)).to(out.device)
    return [out.detach(), *torch.autograd.grad(out, [*space, *time], seed)]


def exact(space, time, points, box, t):
    """The same by plain torch in float64."""
    points, box = points.double(), (box[0].double(), box[1].double())
    space, time = ([p.detach().double().requires_grad_() for p in planes] for planes in (space, time))
    out = lookup_reference((points - box[0]) / (box[1] - box[0]), t, *[p for pair in zip(space, time) for p in pair])
    seed = torch.randn(out.shape, generator=torch.Generator().manual_seed(2)).double()
    return [out.detach(), *torch.autograd.grad(out, [*space, *time], seed)]


def assert_close(found, expected, tolerance=1e-5):
    assert len(found) == len(expected)
    for a, b in zip(found, expected):
        assert a.shape == b.shape and (a - b).norm() <= tolerance * b.norm()


@pytest.mark.parametrize(("channels", "resolutions", "times", "n"), CASES)
def test_features_and_gradients_match_float64(channels, resolutions, times, n):
    space, time = make(channels, resolutions, times)
    assert_close(outcome(Emulator(), space, time, positions(n), BOX, 0.31), exact(space, time, positions(n), BOX, 0.31))


@pytest.mark.parametrize("t", [0.0, 0.2, 1.0, -0.5, 1.5, math.inf, math.nan])
@pytest.mark.parametrize("times", [1, 2, 6])
def test_every_time_matches_float64(times, t):
    space, time = make(16, (5, 9), times)
    assert_close(outcome(Emulator(), space, time, positions(40), BOX, t), exact(space, time, positions(40), BOX, t))


@pytest.mark.parametrize(("channels", "resolutions"), [(16, (5, 9)), (64, (1, 6, 3, 50))])
def test_a_block_that_takes_points_again_and_again(channels, resolutions, monkeypatch):
    monkeypatch.setattr(field, "BACK_BLOCKS", 2)
    space, time = make(channels, resolutions, 6)
    assert_close(outcome(Emulator(), space, time, positions(203), BOX, 0.31), exact(space, time, positions(203), BOX, 0.31))


def test_gradients_are_differences():
    """Features are linear in each of the six planes, so that differences over any distance are their derivatives."""
    space, time = make(16, (5, 9), 4)
    points, t = positions(30), 0.4
    seed = torch.randn(30, 32, generator=torch.Generator().manual_seed(2)).double()
    gradients = outcome(Emulator(), space, time, points, BOX, t)[1:]
    for stack, gradient in zip([*space, *time], gradients):
        for k in range(3):
            way = torch.randn(stack[k].shape, generator=torch.Generator().manual_seed(k))
            ends = []
            with torch.no_grad():
                for step in (way, -2 * way):
                    stack[k] += step
                    ends.append(float((look_up(Emulator(), space, time, points, BOX, t).double() * seed).sum()))
                stack[k] += way
            expected = float((gradient[k].double() * way).sum())
            assert abs((ends[0] - ends[1]) / 2 - expected) <= 1e-5 * float(gradient[k].norm() * way.norm())


def test_without_a_box_it_is_the_unit_box():
    space, time = make(16, (5, 9), 4)
    points = torch.rand(20, 3, generator=torch.Generator().manual_seed(1))
    with_box = outcome(Emulator(), space, time, points, (torch.zeros(3), torch.ones(3)), 0.3)
    assert all(torch.equal(a, b) for a, b in zip(outcome(Emulator(), space, time, points, None, 0.3), with_box))


def test_any_order_of_threads_gives_the_same_within_rounding():
    space, time = make(16, (5, 9), 6)
    points = positions(300)
    first, *others = (outcome(Emulator(seed), space, time, points, BOX, 0.31) for seed in range(4))
    assert any(not torch.equal(a, b) for other in others for a, b in zip(first, other))  # orders do differ
    for other in others:
        assert torch.equal(first[0], other[0])
        assert_close(other, first, 1e-6)


def test_deterministic_gradients_are_bit_equal():
    space, time = make(16, (5, 9), 6)
    points = positions(300)
    plain = outcome(Emulator(), space, time, points, BOX, 0.31)
    with deterministic():
        first, *others = (outcome(Emulator(seed), space, time, points, BOX, 0.31) for seed in range(3))
        without_box = outcome(Emulator(), space, time, (points - BOX[0]) / (BOX[1] - BOX[0]), None, 0.31)
    assert all(torch.equal(a, b) for other in others for a, b in zip(first, other))
    assert torch.equal(first[0], plain[0])
    assert_close(first, plain)
    assert_close(without_box, plain)


@pytest.mark.parametrize("flags", [CHECKED, RACES], ids=["checked", "races"])
def test_no_races_and_nothing_out_of_bounds(flags, monkeypatch):
    monkeypatch.setattr(field, "BACK_BLOCKS", 2)
    space, time = make(12, (1, 6), 3)
    assert_close(outcome(Emulator(flags=flags), space, time, positions(100), BOX, 0.9), exact(space, time, positions(100), BOX, 0.9))


def test_one_position_that_is_not_finite_touches_no_others_gradients():
    space, time = make(16, (5, 9), 4)
    points, poisoned = positions(9)[3:5], positions(9)[3:5]
    poisoned[1, 2] = math.nan
    for at in (points, poisoned):
        out = look_up(Emulator(), space, time, at, BOX, 0.3)
        seed = torch.ones_like(out)
        seed[1] = 0
        found = torch.autograd.grad(out, [*space, *time], seed)
        if at is points:
            expected = found
    assert all(torch.equal(a, b) for a, b in zip(found, expected))


@pytest.mark.parametrize(("channels", "resolutions"), [(12, (1, 3)), (64, (1, 6, 3, 50))])
def test_what_lies_behind_a_single_sample_is_not_touched(channels, resolutions):
    """Neither what the memory behind the first level's planes holds, nor the next level's lines; nor does anything get there from it."""
    space, time = make(channels, resolutions, 1)

    def before_nan(plane):
        memory = torch.full((plane.numel() + 4096,), torch.nan)
        memory[: plane.numel()] = plane.detach().flatten()
        return memory[: plane.numel()].view(plane.shape).requires_grad_()

    space[0], time[0] = before_nan(space[0]), before_nan(time[0])
    with torch.no_grad():
        time[1][0, 0, 0] = torch.nan
    out = look_up(Emulator(), space, time, positions(20), BOX, 0.3)
    assert bool(out[:, :channels].isfinite().all()) and bool(out[:, channels : 2 * channels].isnan().any())
    seed = torch.zeros_like(out)
    seed[:, :channels] = torch.nan
    with torch.no_grad():
        time[1].fill_(1.0)
    out = look_up(Emulator(), space, time, positions(20), BOX, 0.3)
    gradients = torch.autograd.grad(out, [*space, *time], seed)
    bad = [bool(g.isnan().any()) for g in gradients]
    assert bad == [k % len(resolutions) == 0 for k in range(len(bad))]


def test_tensors_that_lie_across_others_are_taken():
    """Not contiguous, or not at a multiple of 16 bytes."""
    space, time = make(12, (1, 6), 3)
    points = positions(20)
    expected = outcome(Emulator(), space, time, points, BOX, 0.3)
    shifted = [torch.cat([torch.zeros(1), p.detach().flatten()])[1:].view(p.shape).requires_grad_() for p in space]
    turned = [p.detach().transpose(1, 2).contiguous().transpose(1, 2).requires_grad_() for p in time]
    assert shifted[0].data_ptr() % 16 and not turned[1].is_contiguous()
    found = outcome(Emulator(flags=CHECKED), shifted, turned, points.t().contiguous().t(), BOX, 0.3)
    assert all(torch.equal(a, b) for a, b in zip(found, expected))


@pytest.mark.parametrize(("channels", "resolutions", "lines"), [(16, (5, 9), 192), (64, (1, 6, 3, 50), 0)])
def test_lines_that_a_block_has_no_room_for_are_not_summed_there(channels, resolutions, lines):
    used = set()

    class Noting(Emulator):
        def launch(self, program, *rest):
            used.add(dict(program.defines).get("LINES"))
            super().launch(program, *rest)

    outcome(Noting(), *make(channels, resolutions, 2), positions(5), BOX, 0.3)
    assert used == {None, lines}
    beside = [16 * 3 * field.BACK_THREADS + 8 * 3 * (field.BACK_THREADS // quads) for quads in range(1, field.MOST_CHANNELS // 4 + 1)]
    assert 16 * field.LINE_QUADS + max(beside) <= 48 * 1024


def test_planes_changed_in_place_before_backward_are_an_error():
    space, time = make(16, (5,), 4)
    out = look_up(Emulator(), space, time, positions(5), BOX, 0.3)
    with torch.no_grad():
        space[0].mul_(2)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        out.sum().backward()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a.update(points=torch.ones(5, 2)), r"points must be \[N, 3\]"),
        (lambda a: a.update(time=[torch.ones(3, 2, 5, 4)]), r"time \[3, T, R, C\]"),
        (lambda a: a.update(space=[torch.ones(3, 4, 3, 4)]), r"space must be \[3, R, R, C\]"),
        (lambda a: a.update(space=[]), "1 to 4 levels"),
        (lambda a: a.update(space=[torch.ones(3, 4, 4, 6)], time=[torch.ones(3, 2, 4, 6)]), "channels; got"),
        (lambda a: a.update(points=torch.ones(5, 3, dtype=torch.float64)), "float32"),
    ],
)
def test_what_the_kernels_do_not_take_is_refused(change, message):
    arguments = {"space": [torch.ones(3, 4, 4, 4)], "time": [torch.ones(3, 2, 4, 4)], "points": torch.ones(5, 3), "box": None, "t": 0.0}
    change(arguments)
    with pytest.raises(ValueError, match=message):
        look_up(Emulator(), **arguments)


@pytest.mark.parametrize(("channels", "taken"), [(16, True), (68, False), (6, False)])
def test_tensors_on_a_gpu_take_the_kernels(channels, taken, monkeypatch):
    """With stand-ins for what lies on a GPU."""
    device, emulator = torch.device("cuda", 0), Emulator()

    def on_gpu(*shape):
        return SimpleNamespace(is_cuda=True, dtype=torch.float32, device=device, shape=shape, detach=lambda: points)

    points, space, time = None, [on_gpu(3, 4, 4, channels)], [on_gpu(3, 2, 4, channels)]
    points = on_gpu(5, 3)
    monkeypatch.setattr(field, "look_up", lambda *given: ("kernel", *given))
    monkeypatch.setattr(field_kernel, "lookup_reference", lambda *given: ("plain", *given))
    with launching("cuda", emulator):
        found = field_kernel.field_outputs(space, time, [], points, None, 0.5)
    assert found == (("kernel", emulator, space, time, points, None, 0.5) if taken else ("plain", points, 0.5, *space, *time))


@pytest.mark.cuda
@pytest.mark.parametrize(("channels", "resolutions", "times", "n"), CASES)
def test_on_a_gpu_features_and_gradients_match_float64(channels, resolutions, times, n):
    from e4dgs.rasterizer.cuda.runtime import launcher_for

    space, time = make(channels, resolutions, times)
    there = [[p.detach().cuda().requires_grad_() for p in planes] for planes in (space, time)]
    box, points = (BOX[0].cuda(), BOX[1].cuda()), positions(n).cuda()
    launcher = launcher_for(points.device)
    expected = exact(space, time, positions(n), BOX, 0.31)
    assert_close([p.cpu() for p in outcome(launcher, *there, points, box, 0.31)], expected)
    with deterministic():
        first, second = (outcome(launcher, *there, points, box, 0.31) for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(first, second))
    assert_close([p.cpu() for p in first], expected)


@pytest.mark.cuda
def test_on_a_gpu_the_field_moves_as_on_the_cpu_and_can_be_captured():
    fields = []
    for device in ("cpu", "cuda"):
        one = DeformationField(BOX[0].to(device), BOX[1].to(device), 5)
        with torch.no_grad():
            one.head.weight.copy_(0.1 * torch.randn(one.head.weight.shape, generator=torch.Generator().manual_seed(4)))
        fields.append(one)
    rest = BOX[0] + (BOX[1] - BOX[0]) * torch.rand(1000, 3, generator=torch.Generator().manual_seed(1))
    expected = [p.detach() for p in fields[0](rest, 0.3)]
    there, moving = rest.cuda(), fields[1]

    def step():
        moving.zero_grad()
        moved = moving(there, 0.3)
        sum(part.square().sum() for part in moved).backward()
        return moved

    side = torch.cuda.Stream()
    with torch.cuda.stream(side):
        step()
    torch.cuda.synchronize()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        captured = step()
    graph.replay()
    torch.cuda.synchronize()
    assert fields[0].reach == fields[1].reach
    assert_close([p.detach().cpu() for p in captured], expected)
