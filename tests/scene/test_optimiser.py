"""RowAdam against torch's Adam, and what it leaves alone."""

import platform

import pytest
import torch
from e4dgs.scene import _kernels
from e4dgs.scene.training.optimiser import ALL_ROWS, EPSILON, RowAdam, Rows


def parameters(dtype=torch.float32):
    generator = torch.Generator().manual_seed(1)
    shapes = {
        "a.wide": (700, 45),
        "a.one": (700,),
        "a.two": (130, 2),
        "a.three": (64, 3),
        "a.four": (65, 4),
        "b.cube": (50, 4, 3),
        "b.none": (0, 3),
    }
    return {name: torch.randn(shape, generator=generator).to(dtype).requires_grad_() for name, shape in shapes.items()}


def test_steps_are_those_of_adam_in_float64():
    ours, exact = parameters(), parameters(torch.float64)
    adam = RowAdam(ours, {name: lambda progress: 0.01 * (1 - progress) for name in ours})
    reference = torch.optim.Adam(list(exact.values()), lr=0.01, betas=(0.9, 0.99), eps=EPSILON)
    start = {name: p.detach().clone() for name, p in exact.items()}
    generator = torch.Generator().manual_seed(2)
    for step in range(20):
        for name, p in ours.items():
            p.grad = torch.randn(p.shape, generator=generator)
            exact[name].grad = p.grad.double()
        reference.param_groups[0]["lr"] = 0.01 * (1 - step / 20)
        adam.step(step / 20)
        reference.step()
    for name, p in ours.items():
        change = exact[name].detach() - start[name]
        assert (p.detach() - exact[name].detach()).norm() <= 1e-5 * change.norm()
        assert p.grad is None


@pytest.mark.parametrize("width", [1, 2, 3, 4, 5, 24])
def test_rows_without_a_gradient_keep_value_and_moments(width):
    ours = {"a.wide": torch.ones(6, width, requires_grad=True)}
    adam = RowAdam(ours, {"a.wide": lambda progress: 0.1})
    p = ours["a.wide"]
    p.grad = torch.ones(6, width)
    adam.step(0.0)
    before, moments = p.detach().clone(), {k: v.clone() for k, v in adam.state().items()}
    p.grad = torch.zeros(6, width)
    p.grad[2, -1], p.grad[5, 0] = 0.5, torch.nan
    adam.step(0.5)
    changed = (p.detach() != before).any(1)
    assert changed.tolist() == [False, False, True, False, False, True]
    for key in ("exp_avg", "exp_avg_sq"):
        assert torch.equal(adam.state()[f"a.wide/{key}"][~changed], moments[f"a.wide/{key}"][~changed])


@pytest.mark.parametrize("chosen", [[], [6], list(range(0, 690, 3)), list(range(700))], ids=["none", "one", "a third", "all"])
@pytest.mark.parametrize("width", [1, 3, 4, 45])
def test_copied_rows_step_as_the_rows_themselves_would(width, chosen):
    generator = torch.Generator().manual_seed(width)
    start, index = torch.randn(700, width, generator=generator), torch.tensor(chosen, dtype=torch.int64)
    ends = []
    for copied in (False, True):
        p = start.clone().requires_grad_()
        adam = RowAdam({"a.p": p}, {"a.p": lambda progress: 0.1})
        draw = torch.Generator().manual_seed(7)
        for _ in range(5):
            grad = torch.randn(len(chosen), width, generator=draw)
            grad[::5] = 0  # in the copy, too, a row without a gradient keeps what it has
            if copied:
                rows = p.detach().index_select(0, index).requires_grad_()
                rows.grad = grad
                adam.step(0.0, rows=Rows(index, {"a.p": rows}))
            else:
                p.grad = torch.zeros_like(p)
                p.grad[index] = grad
                adam.step(0.0)
        ends.append((p.detach(), adam.state()))
    assert torch.equal(ends[0][0], ends[1][0])
    if chosen:
        assert all(torch.equal(ends[0][1][key], ends[1][1][key]) for key in ends[0][1])
        assert len(chosen) == 1 or not torch.equal(ends[0][0], start)


@pytest.mark.parametrize("width", [1, 2, 3, 4, 5, 45])
@pytest.mark.parametrize("copied", [False, True], ids=["all rows", "copied rows"])
def test_rows_step_at_their_own_pace(copied, width):
    """Of every width that the kernel treats on its own, and in more rows than it takes at once. Parameters of other owners have none."""
    generator = torch.Generator().manual_seed(width)
    start, spans = torch.randn(700, width, generator=generator), torch.randn(700, generator=generator)
    index = torch.arange(0, 699, 3)
    ends = []
    for pace in (lambda p: torch.exp(-p["log_spans"]) if "log_spans" in p else None, lambda p: None):
        named = {"a.p": start.clone(), "a.log_spans": spans.clone(), "b.q": torch.ones(4, width)}
        adam = RowAdam({k: p.requires_grad_() for k, p in named.items()}, {name: lambda progress: 0.1 for name in named}, pace=pace)
        draw = torch.Generator().manual_seed(7)
        for _ in range(5):
            grad = torch.randn(700, width, generator=draw)
            named["b.q"].grad = torch.ones(4, width)
            if copied:
                rows = {name: named[name].detach()[index].requires_grad_() for name in ("a.p", "a.log_spans")}
                rows["a.p"].grad = grad[index]
                adam.step(0.0, rows=Rows(index, rows))
            else:
                named["a.p"].grad = grad
                adam.step(0.0)
        ends.append({name: p.detach() for name, p in named.items()})
    paced, plain = ends
    stepped = index if copied else torch.arange(700)
    change = torch.zeros(700, width)
    change[stepped] = torch.exp(-spans)[stepped, None] * (plain["a.p"] - start)[stepped]
    torch.testing.assert_close(paced["a.p"], start + change, rtol=1e-5, atol=1e-5)
    assert torch.equal(paced["b.q"], plain["b.q"])


def test_gradients_of_rows_and_of_the_whole_are_added():
    index = torch.tensor([1, 3])
    ends = []
    for split in (False, True):
        p = torch.ones(5, 3, requires_grad=True)
        adam = RowAdam({"a.p": p}, {"a.p": lambda progress: 0.1})
        p.grad, rows = torch.full((5, 3), 0.5), torch.ones(2, 3, requires_grad=True)
        rows.grad = torch.full((2, 3), -2.0)
        if not split:
            p.grad[index] += rows.grad
        adam.step(0.0, rows=Rows(index, {"a.p": rows}) if split else ALL_ROWS)
        ends.append(p.detach())
    assert torch.equal(ends[0], ends[1]) and float(ends[0][1, 0]) > 1 > float(ends[0][0, 0])


def test_rows_of_a_kind_that_is_frozen_stay():
    p = torch.ones(4, 2, requires_grad=True)
    adam = RowAdam({"a.p": p}, {"a.p": lambda progress: 0.1})
    rows = torch.ones(2, 2, requires_grad=True)
    rows.grad = torch.ones(2, 2)
    adam.step(0.0, frozenset({"a"}), Rows(torch.tensor([1, 3]), {"a.p": rows}))
    assert torch.equal(p.detach(), torch.ones(4, 2)) and not adam.state()


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="other processors are not slowed by such numbers")
def test_moments_below_the_normal_numbers_are_zero():
    ours = {"a.wide": torch.ones(1, 2, requires_grad=True)}
    adam = RowAdam(ours, {"a.wide": lambda progress: 0.1})
    ours["a.wide"].grad = torch.tensor([[1e-38, 1.0]])
    adam.step(0.0)
    first = adam.state()["a.wide/exp_avg"]
    assert float(first[0, 0]) == 0.0 and float(first[0, 1]) > 0.0


def test_frozen_parameters_and_replaced_rows():
    ours = parameters()
    adam = RowAdam(ours, {name: lambda progress: 0.1 for name in ours})
    for p in ours.values():
        p.grad = torch.ones_like(p)
    before = ours["a.one"].detach().clone()
    adam.step(0.0, frozenset({"a"}))
    assert torch.equal(ours["a.one"], before) and "a.one/step" not in adam.state() and "b.cube/step" in adam.state()
    source = torch.tensor([3, -1, 0])
    new = torch.zeros(3, 4, 3, requires_grad=True)
    old = adam.state()["b.cube/exp_avg"].clone()
    adam.replace("b.cube", new, source)
    moved = adam.state()["b.cube/exp_avg"]
    assert adam.parameters()["b.cube"] is new
    assert torch.equal(moved[0], old[3]) and not moved[1].any() and torch.equal(moved[2], old[0])


def test_state_survives_saving():
    runs = []
    for interrupted in (False, True):
        ours = parameters()
        adam = RowAdam(ours, {name: lambda progress: 0.1 for name in ours})
        for step in range(4):
            if interrupted and step == 2:
                kept = {name: value.clone() for name, value in adam.state().items()}
                adam = RowAdam(ours, {name: lambda progress: 0.1 for name in ours})
                adam.load_state(kept)
            for p in ours.values():
                p.grad = torch.full_like(p, 1.0 + step)
            adam.step(0.0)
        runs.append(ours)
    assert all(torch.equal(runs[0][name], runs[1][name]) for name in runs[0])


def test_wrong_shapes_are_refused():
    with pytest.raises(ValueError, match="index names a row"):
        _kernels.adam([(torch.ones(3), torch.ones(1), torch.ones(3), torch.ones(3), None, torch.tensor([3]), 1, 0.1)], 0.9, 0.99, 1e-8, 1)
    with pytest.raises(ValueError, match="the rows it belongs to"):
        _kernels.adam([(torch.ones(3), torch.ones(2), torch.ones(3), torch.ones(3), None, None, 1, 0.1)], 0.9, 0.99, 1e-8, 1)
    x = torch.ones(6, 3)
    for pace, index in ((torch.ones(5), None), (torch.ones(6), torch.tensor([1, 2]))):
        grad = x if index is None else x[:2]
        with pytest.raises(ValueError, match="pace must have one number for each row of gradient"):
            _kernels.adam([(x.clone(), grad, x.clone(), x.clone(), pace, index, 1, 0.1)], 0.9, 0.99, 1e-8, 1)
