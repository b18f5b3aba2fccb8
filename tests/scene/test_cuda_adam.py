"""The GPU's row-sparse Adam of many tensors, under the emulator, against the CPU's kernel and plain float64."""

from math import prod

import pytest
import torch
from e4dgs.rasterizer.cuda.runtime import launcher_for
from e4dgs.scene import _kernels
from e4dgs.scene.cuda.adam import CHUNK, THREADS, Update, step_if_finite
from e4dgs.scene.training.optimiser import RowAdam
from pretend_cuda import pretending_cuda
from simt import CHECKED, RACES, Emulator, needs_compiler

pytestmark = needs_compiler
RATE, EPSILON = 0.1, 1e-15
BETA1, BETA2 = torch.tensor([0.9, 0.99]).tolist()  # as float32 has them, or 1 - beta would differ in its seventh digit
# One number, widths 1, 3, 45 and 48 in several blocks, all but one number of a block, a block, one more, and rows of several blocks.
SHAPES = [(), (1,), (2100,), (700, 3), (60, 15, 3), (50, 48), (300, 4), (3, CHUNK - 1), (3, CHUNK), (3, CHUNK + 1), (3, 10, 20, 25)]
GUARD = 2 * CHUNK
CPU = torch.device("cpu")
WIDTHS = [1, 3, 48, CHUNK - 1, CHUNK, CHUNK + 1, 5000]


def rows_of(tensor):
    """[rows, width]; what the rows of a tensor are."""
    return tensor.reshape(tensor.shape[0] if tensor.ndim else 1, prod(tensor.shape[1:]))


def guarded(values):
    """A copy between numbers that nobody may write, as many as a block and more could."""
    whole = torch.full((values.numel() + 2 * GUARD,), 7.0)
    whole[GUARD:-GUARD] = values.reshape(-1)
    return whole[GUARD:-GUARD].view(values.shape)


def is_intact(tensor):
    whole = torch.empty(0).set_(tensor.untyped_storage())
    return bool((whole[:GUARD] == 7).all() and (whole[-GUARD:] == 7).all())


def start(shape, seed=0):
    """Parameter and moments as after some steps, and a gradient that about a third of the rows lack."""
    generator = torch.Generator().manual_seed(seed)
    p, g, m, v = (torch.randn(shape, generator=generator) for _ in range(4))
    rows = rows_of(g)
    rows[torch.rand(rows.shape[0], generator=generator) < 0.35] = 0
    rows[rows.abs() < 0.3] = 0  # other rows have some zeros as well
    return p, g, 0.1 * m, 0.02 + 0.01 * v.square()


def take(launcher, *cases, number=3, device=CPU, pace=None):
    """One step of all cases together, in place; what was found to be bad."""
    updates = [Update(g, p, m, v, number, RATE, pace) for p, g, m, v in cases]
    return step_if_finite(launcher, device, updates, BETA1, BETA2, EPSILON).tolist()


def step(case, number=3, launcher=None, pace=None):
    """(parameter, first, second) after a step on the GPU."""
    p, g, m, v = map(guarded, case)
    assert take(launcher or Emulator(), (p, g, m, v), number=number, pace=pace) == [False, False]
    assert all(map(is_intact, (p, g, m, v)))
    return p, m, v


def step_on_cpu(case, number=3, pace=None):
    p, g, m, v = (t.clone() for t in case)
    _kernels.adam([(p, g, m, v, pace, None, number, RATE)], BETA1, BETA2, EPSILON, 1)
    return p, m, v


def step_exactly(case, number=3):
    p, g, m, v = (t.double() for t in case)
    seen = rows_of(g != 0).any(1).reshape(-1, *[1] * (max(g.ndim, 1) - 1)).expand(g.shape if g.ndim else (1,)).reshape(g.shape)
    m_new, v_new = BETA1 * m + (1 - BETA1) * g, BETA2 * v + (1 - BETA2) * g * g
    change = RATE * (m_new / (1 - BETA1**number)) / ((v_new / (1 - BETA2**number)).sqrt() + EPSILON)
    return tuple(torch.where(seen, new, old) for new, old in ((p - change, p), (m_new, m), (v_new, v)))


def same_bits(a, b):
    return torch.equal(a.reshape(-1).view(torch.int32), b.reshape(-1).view(torch.int32))


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_a_step_is_that_of_the_cpu_and_of_float64(shape):
    case = start(shape)
    if not case[1].any():
        case[1].fill_(0.5)
    ours, theirs, exact = step(case), step_on_cpu(case), step_exactly(case)
    for got, on_cpu, want in zip(ours, theirs, exact):
        assert (got - want).abs().max() <= 2e-7 * want.abs().max()
        assert (got - on_cpu).abs().max() <= 2e-7 * want.abs().max()
    change = exact[0] - case[0]
    assert (ours[0] - exact[0]).norm() <= 2e-6 * change.norm()


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_rows_step_at_their_own_pace(shape):
    case = start(shape)
    if not case[1].any():
        case[1].fill_(0.5)
    pace = 0.5 + torch.rand(rows_of(case[0]).shape[0], generator=torch.Generator().manual_seed(3))
    plain, ours, theirs = step(case), step(case, pace=pace), step_on_cpu(case, pace=pace)
    of_rows = pace.view([len(pace), *[1] * (len(shape) - 1)] if shape else [])
    want = case[0] + of_rows * (plain[0] - case[0])
    assert (ours[0] - want).abs().max() <= 4e-7 * want.abs().max()
    assert (ours[0] - theirs[0]).abs().max() <= 2e-7 * want.abs().max()
    assert all(map(same_bits, ours[1:], plain[1:]))  # moments know no pace


@pytest.mark.parametrize("number", [1, 7, 100_000])
def test_steps_are_corrected_by_their_number(number):
    case = start((40, 3))
    for got, on_cpu, want in zip(step(case, number), step_on_cpu(case, number), step_exactly(case, number)):
        assert (got - want).abs().max() <= 2e-7 * want.abs().max()
        assert (got - on_cpu).abs().max() <= 2e-7 * want.abs().max()


@pytest.mark.parametrize("width", WIDTHS)
def test_rows_without_a_gradient_keep_every_bit(width):
    """Also where they hold what is not a number, and where their gradient is -0."""
    case = start((7, width))
    case[1][:] = 0
    case[1][2, 0] = case[1][5, width - 1] = 1e-40  # denormals count, at either end of a row
    case[1][3] = -0.0
    for t, value in zip((case[0], case[2], case[3]), (torch.nan, torch.inf, -1.0)):
        t[1] = value
    after = step(case)
    still = torch.tensor([0, 1, 3, 4, 6])
    for now, before in zip(after, (case[0], case[2], case[3])):
        assert same_bits(now[still], before[still])
        for row in (2, 5):
            assert (now[row] != before[row]).all()  # moments decay, and a moment moves its number


def test_a_gradient_moves_its_row_alone_wherever_it_is():
    """Rows that begin and end anywhere in the words of bits that a block keeps."""
    emulator = Emulator()
    for rows, width in [(70, 1), (30, 5), (40, 31), (9, 32), (9, 33), (12, 97)]:
        for at in range(0, rows * width, 7):
            first, second = torch.ones(rows, width), torch.ones(rows, width)
            grad = torch.zeros(rows, width)
            grad.view(-1)[at] = 1.0
            take(emulator, (torch.zeros(rows, width), grad, first, second), number=1)
            moved = (second != 1).sum(1)
            assert moved[at // width] >= width - 1 and moved.sum() == moved[at // width], (rows, width, at)


def test_many_tensors_step_at_once_as_each_alone():
    """Tensors without numbers among them and at either end; each has a step number and a rate of its own."""
    shapes = [(0, 3), *SHAPES, (3, 0), (5, 0, 2), *((1 + k % 3, 1 + k % 50) for k in range(260)), (0,)]
    cases = [tuple(map(guarded, start(shape, seed))) for seed, shape in enumerate(shapes)]
    number, rate = [1 + k % 5 for k in range(len(cases))], [RATE * (1 + k % 3) for k in range(len(cases))]
    alone = [[t.clone() for t in case] for case in cases]
    updates = [Update(g, p, m, v, n, r) for (p, g, m, v), n, r in zip(cases, number, rate)]
    assert len(updates) > THREADS  # a block looks for its tensor in several rounds
    assert not step_if_finite(Emulator(), CPU, updates, BETA1, BETA2, EPSILON).any()
    for case, (p, g, m, v), n, r in zip(cases, alone, number, rate):
        step_if_finite(Emulator(), CPU, [Update(g, p, m, v, n, r)], BETA1, BETA2, EPSILON)
        assert all(map(is_intact, case))
        assert all(same_bits(*pair) for pair in zip(case, (p, g, m, v)))


@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
@pytest.mark.parametrize("shape", [(), (2100,), (700, 3), (50, 48), (3, CHUNK), (3, 5000)], ids=str)
def test_one_number_that_is_not_finite_stops_all(shape, value):
    """First and last number, of a tensor that steps or is only checked."""
    others = [start((40, 3)), start((2, CHUNK + 1))]
    for place in (0, -1):
        for moves in (True, False):
            case = start(shape)
            case[1].view(-1)[place] = value
            cases = [others[0], case, others[1]]
            before = [[t.clone() for t in each] for each in cases]
            updates = [Update(g, p, m, v, 3, RATE) if moves or g is not case[1] else Update(g) for p, g, m, v in cases]
            bad = step_if_finite(Emulator(), CPU, updates, BETA1, BETA2, EPSILON)
            assert bad.tolist() == [True, False, True, False]
            assert all(same_bits(*pair) for now, then in zip(cases, before) for pair in zip(now, then))


def test_numbers_whose_sum_overflows_are_finite():
    p, g, m, v = start((3, 5))
    g[:] = 3e38
    assert take(Emulator(), (p, g, m, torch.full_like(v, 1e38))) == [False, False]


def test_tensors_that_are_only_checked_do_not_hold_up_the_others():
    case, loss = start((300, 4)), torch.tensor(0.5)
    want = step_on_cpu(case)
    p, g, m, v = (t.clone() for t in case)
    updates = [Update(loss), Update(torch.ones(3, 5000)), Update(g, p, m, v, 3, RATE), Update(g)]
    assert not step_if_finite(Emulator(), CPU, updates, BETA1, BETA2, EPSILON).any()
    for got, expected in zip((p, m, v), want):
        torch.testing.assert_close(got, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("shape", [(400, 3), (30, 45), (3, 5000)], ids=str)
def test_bit_equal_in_any_order_of_threads(shape):
    case = start(shape)
    first = step(case)
    for launcher in (Emulator(1), Emulator(2), Emulator(3, CHECKED), Emulator(4, RACES)):
        for now, before in zip(step(case, launcher=launcher), first):
            assert same_bits(now, before)


@pytest.mark.parametrize("launcher", [Emulator(1), Emulator(3, CHECKED), Emulator(4, RACES)], ids=["order", "bounds", "races"])
def test_many_tensors_in_any_order_of_threads(launcher):
    """Also where many threads find what is not finite."""
    shapes = [(700, 3), (), (3, 5000), (50, 48), (2, CHUNK)]
    cases, plain = ([start(shape) for shape in shapes] for _ in range(2))
    assert take(launcher, *cases) == take(Emulator(), *plain) == [False] * 6
    assert all(same_bits(*pair) for now, then in zip(cases, plain) for pair in zip(now, then))
    cases[0][1][:], cases[2][1][:] = torch.nan, torch.inf
    assert take(launcher, *cases) == [True, True, False, True, False, False]


def test_wrong_arguments_are_refused_and_no_rows_are_nothing_to_do():
    p = torch.ones(3, 2)
    with pytest.raises(ValueError, match=r"float32 \[3, 3\] on cpu, as is the gradient; got torch.float32 \[3, 2\] on cpu"):
        take(Emulator(), (p, torch.ones(3, 3), p, p))
    with pytest.raises(ValueError, match=r"got torch.float64 \[3, 2\]"):
        take(Emulator(), (p, p, p.double(), p))
    with pytest.raises(ValueError, match="not contiguous"):
        take(Emulator(), (p, torch.ones(2, 3).T, p, p))
    with pytest.raises(ValueError, match="on meta"):
        take(Emulator(), (p, p.to("meta"), p, p))
    with pytest.raises(ValueError, match="both moments"):
        step_if_finite(Emulator(), CPU, [Update(p, p)], BETA1, BETA2, EPSILON)
    with pytest.raises(ValueError, match=r"pace must be contiguous float32 \[3\] on cpu; got torch.float32 \[2\]"):
        take(Emulator(), (p, p, p, p), pace=torch.ones(2))
    with pytest.raises(ValueError, match="number 1"):
        take(Emulator(), (p, p, p, p), number=0)
    for shape in ((0, 3), (3, 0)):
        assert take(Emulator(), [torch.ones(shape) for _ in range(4)]) == [False, False]


def test_the_optimiser_steps_where_its_parameters_lie():
    """In two launches, without waiting, and as if a step that was not finite had not been."""
    shapes = {"a.p": (20, 3), "a.log_spans": (20,), "b.wide": (3, 1500), "b.none": (0, 3), "c.frozen": (4,)}
    generator = torch.Generator().manual_seed(5)
    start = {name: torch.randn(shape, generator=generator) for name, shape in shapes.items()}
    grads = {name: torch.randn(shape, generator=generator) for name, shape in shapes.items()}
    ends = []

    def pace(own):
        return torch.exp(-own["log_spans"]) if "log_spans" in own else None

    with pretending_cuda() as pretending:
        for device in ("cpu", "cuda"):
            named = {name: p.clone().to(device).requires_grad_() for name, p in start.items()}
            adam = RowAdam(named, {name: lambda progress: 0.1 for name in named}, pace=pace)
            for bad in (False, True, False):
                for name, p in named.items():
                    p.grad = grads[name].to(device, copy=True)
                if bad:
                    named["c.frozen"].grad[1] = torch.inf
                pretending.kernels.clear()
                pretending.syncs.clear()
                if device == "cuda":
                    attempt = adam.step_if_finite({"the loss": torch.ones((), device=device)}, 0.0, frozenset({"c"}))
                    assert pretending.kernels == ["check_gradients", "adam_rows"] and not pretending.syncs
                    assert attempt.names == ["the loss", "a.p", "a.log_spans", "b.wide", "c.frozen"]
                    assert attempt.bad.tolist() == [bad, False, False, False, False, bad]
                    if bad:
                        adam.uncount(attempt)
                elif not bad:
                    adam.step(0.0, frozenset({"c"}))
                else:
                    adam.zero_grad()
                assert all(p.grad is None for p in named.values())
            ends.append({name: p.detach().cpu() for name, p in named.items()} | {k: v.cpu() for k, v in adam.state().items()})
    assert ends[0].keys() == ends[1].keys()
    for name, want in ends[0].items():
        torch.testing.assert_close(ends[1][name], want, rtol=1e-6, atol=1e-6)


@pytest.mark.cuda
def test_on_a_gpu_a_step_is_that_of_the_cpu():
    cases = [start(shape, seed) for seed, shape in enumerate(SHAPES)]
    there = [[t.cuda() for t in case] for case in cases]
    device = there[0][0].device
    assert not any(take(launcher_for(device), *there, device=device))
    for (p, _, m, v), case in zip(there, cases):
        for got, want in zip((p, m, v), step_on_cpu(case)):
            torch.testing.assert_close(got.cpu(), want, rtol=1e-6, atol=1e-6)


@pytest.mark.cuda
@pytest.mark.parametrize("at", range(len(SHAPES)))
def test_on_a_gpu_one_number_that_is_not_finite_stops_all(at):
    there = [[t.cuda() for t in start(shape)] for shape in SHAPES]
    there[at][1].view(-1)[-1] = torch.nan
    before = [[t.clone() for t in case] for case in there]
    device = there[0][0].device
    bad = take(launcher_for(device), *there, device=device)
    assert bad == [True, *(k == at for k in range(len(SHAPES)))]
    assert all(same_bits(*pair) for now, then in zip(there, before) for pair in zip(now, then))
