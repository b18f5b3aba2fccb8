"""The GPU's row-sparse Adam, under the emulator, against the CPU's kernel and plain float64."""

import pytest
import torch
from e4dgs.rasterizer.cuda.runtime import launcher_for, launching
from e4dgs.scene import _kernels
from e4dgs.scene.cuda.adam import CHUNK, adam_rows
from e4dgs.scene.training.optimiser import RowAdam
from simt import CHECKED, RACES, Emulator, needs_compiler

pytestmark = needs_compiler
RATE, EPSILON = 0.1, 1e-15
BETA1, BETA2 = torch.tensor([0.9, 0.99]).tolist()  # as float32 has them, or 1 - beta would differ in its seventh digit
# One number, widths 1, 3, 45 and 48 in several blocks, all but one number of a block, a block, one more, and rows of several blocks.
SHAPES = [(), (1,), (2100,), (700, 3), (60, 15, 3), (50, 48), (300, 4), (3, CHUNK - 1), (3, CHUNK), (3, CHUNK + 1), (3, 10, 20, 25)]
GUARD = 2 * CHUNK
WIDTHS = [1, 3, 48, CHUNK - 1, CHUNK, CHUNK + 1, 5000]


def rows_of(tensor):
    """[rows, width]; what the rows of a tensor are."""
    return tensor.reshape(tensor.shape[0] if tensor.ndim else 1, -1)


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


def step(case, number=3, seed=0, flags=(), launcher=None):
    """(parameter, first, second) after a step on the GPU."""
    p, g, m, v = map(guarded, case)
    adam_rows(launcher or Emulator(seed, flags), p, g, m, v, number, RATE, BETA1, BETA2, EPSILON)
    assert all(map(is_intact, (p, g, m, v)))
    return p, m, v


def step_on_cpu(case, number=3):
    p, g, m, v = (t.clone() for t in case)
    _kernels.adam_rows(p, g, m, v, None, number, RATE, BETA1, BETA2, EPSILON, 1)
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
            adam_rows(emulator, torch.zeros(rows, width), grad, first, second, 1, RATE, BETA1, BETA2, EPSILON)
            moved = (second != 1).sum(1)
            assert moved[at // width] >= width - 1 and moved.sum() == moved[at // width], (rows, width, at)


@pytest.mark.parametrize("width", [1, 3, 48, 5000])
def test_what_is_not_a_number_is_a_gradient(width):
    case = start((5, width))
    case[1][:] = 0
    case[1][1, width // 2], case[1][4, 0] = torch.nan, torch.inf
    ours, theirs = step(case), step_on_cpu(case)
    for got, want, before in zip(ours, theirs, (case[0], case[2], case[3])):
        torch.testing.assert_close(got, want, rtol=1e-6, atol=1e-7, equal_nan=True)
        assert same_bits(got[[0, 2, 3]], before[[0, 2, 3]])
        assert not got[1, width // 2].isfinite()


@pytest.mark.parametrize("shape", [(400, 3), (30, 45), (3, 5000)], ids=str)
def test_bit_equal_in_any_order_of_threads(shape):
    case = start(shape)
    first = step(case)
    for launcher in (Emulator(1), Emulator(2), Emulator(3, CHECKED), Emulator(4, RACES)):
        for now, before in zip(step(case, launcher=launcher), first):
            assert same_bits(now, before)


def test_wrong_arguments_are_refused_and_no_rows_are_nothing_to_do():
    p = torch.ones(3, 2)

    def call(*tensors, number=1):
        adam_rows(Emulator(), *tensors, number, RATE, BETA1, BETA2, EPSILON)

    with pytest.raises(ValueError, match="parameter's shape"):
        call(p, torch.ones(3, 3), p, p)
    with pytest.raises(ValueError, match="float32"):
        call(p, p, p.double(), p)
    with pytest.raises(ValueError, match="number 1"):
        call(p, p, p, p, number=0)
    for shape in ((0, 3), (3, 0)):
        call(*(torch.ones(shape) for _ in range(4)))


class OnGpu(torch.Tensor):
    """A tensor of the CPU that says it lies on a GPU."""

    @property
    def device(self):
        return torch.device("cuda", 0)


class Pretending(Emulator):
    def launch(self, program, kernel, blocks, threads, *arguments):
        plain = (a.as_subclass(torch.Tensor) if isinstance(a, torch.Tensor) else a for a in arguments)
        super().launch(program, kernel, blocks, threads, *plain)


def test_the_optimiser_steps_where_its_parameters_lie(monkeypatch):
    shapes = {"a": (20, 3), "b": (3, 1500)}
    generator = torch.Generator().manual_seed(5)
    start = {name: torch.randn(shape, generator=generator) for name, shape in shapes.items()}
    grads = {name: torch.randn(shape, generator=generator) for name, shape in shapes.items()}
    plain = {name: p.clone().requires_grad_() for name, p in start.items()}
    there = {name: p.clone().as_subclass(OnGpu).requires_grad_() for name, p in start.items()}
    with launching("cuda", Pretending()):
        for named in (plain, there):
            adam = RowAdam(named, {name: lambda progress: 0.1 for name in named})
            for _ in range(2):
                for name, p in named.items():
                    p.grad = grads[name].as_subclass(type(p))
                if named is there:
                    monkeypatch.setattr(_kernels, "adam_rows", None)
                adam.step(0.0)
    for name in shapes:
        torch.testing.assert_close(there[name].as_subclass(torch.Tensor), plain[name], rtol=1e-6, atol=1e-6)


@pytest.mark.cuda
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_on_a_gpu_a_step_is_that_of_the_cpu(shape):
    case = start(shape)
    p, g, m, v = (t.cuda() for t in case)
    adam_rows(launcher_for(p.device), p, g, m, v, 3, RATE, BETA1, BETA2, EPSILON)
    for got, want in zip((p, m, v), step_on_cpu(case)):
        torch.testing.assert_close(got.cpu(), want, rtol=1e-6, atol=1e-6)


@pytest.mark.cuda
def test_on_a_gpu_a_graph_repeats_a_step():
    case = start((300, 48))
    p, g, m, v = (t.cuda() for t in case)
    launcher = launcher_for(p.device)
    adam_rows(launcher, p.clone(), g, m.clone(), v.clone(), 3, RATE, BETA1, BETA2, EPSILON)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        adam_rows(launcher, p, g, m, v, 3, RATE, BETA1, BETA2, EPSILON)
    graph.replay()
    for got, want in zip((p, m, v), step_on_cpu(case)):
        torch.testing.assert_close(got.cpu(), want, rtol=1e-6, atol=1e-6)
