"""The fused field and the displacement kernel against plain float64 torch, for every instruction set, and their promises."""

import copy

import pytest
import torch
from e4dgs.scene import _kernels
from e4dgs.scene.motion.planes.displace import displace
from e4dgs.scene.motion.planes.field import DeformationField

KERNELS = ("avx512", "avx2", "baseline")


@pytest.fixture(params=KERNELS)
def kernels(request):
    if not _kernels.select_kernels(request.param):
        pytest.skip(f"this processor or build has no kernels {request.param!r}")
    yield request.param
    next(name for name in KERNELS if _kernels.select_kernels(name))


def make(channels=16, width=64, resolutions=(5, 9), times=4):
    """A field whose weights are all at work, with pre-activations that stay away from zero: see `margin`."""
    field = DeformationField(torch.tensor([-1.0, 0, 2]), torch.tensor([1.0, 3, 2.5]), times, resolutions, channels, width)
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        for p in field.planes.parameters():
            p.add_(0.2 * torch.randn(p.shape, generator=generator))
        for layer in (field.trunk[0], field.trunk[2], field.head):
            layer.bias.copy_(0.3 * torch.randn(layer.bias.shape, generator=generator))
        field.head.weight.copy_(0.3 * torch.randn(field.head.weight.shape, generator=generator))
    return field


def positions(n, field):
    size = field.high - field.low
    return field.low + size * (torch.rand(n, 3, generator=torch.Generator().manual_seed(1)) * 1.2 - 0.1)  # some outside the box


def margin(field, rest, t):
    """[N] the smallest absolute pre-activation of each point: a ReLU decides there, and rounding may decide otherwise."""
    u = (rest - field.low) / (field.high - field.low)
    first = field.trunk[0](field.planes(u, t))
    second = field.trunk[2](first.relu())
    return torch.cat([first, second], 1).abs().amin(1)


@pytest.mark.parametrize(("channels", "width"), [(16, 64), (32, 64), (5, 24), (1, 3)])
@pytest.mark.parametrize("t", [0.0, 0.31, 1.0, 1.7])
def test_displacements_and_gradients_match_float64(channels, width, t, kernels):
    field = make(channels, width)
    rest = positions(301, field).requires_grad_()
    exact_field, exact_rest = copy.deepcopy(field).double(), rest.detach().double().requires_grad_()
    clear = (margin(exact_field, exact_rest, t) > 1e-4).double().detach()[:, None]
    generator = torch.Generator().manual_seed(2)
    seeds = [torch.randn(301, k, generator=generator) * clear.float() for k in (3, 4, 3)]
    ours, exact = field(rest, t), exact_field(exact_rest, t)
    for a, b in zip(ours, exact):
        assert (a - b).norm() <= 2e-6 * b.norm()
    grads = torch.autograd.grad(ours, [rest, *field.parameters()], seeds)
    expected = torch.autograd.grad(exact, [exact_rest, *exact_field.parameters()], [s.double() for s in seeds])
    for a, b in zip(grads, expected):
        assert (a - b).norm() <= 1e-5 * b.norm()


def test_float64_oracle_matches_central_differences():
    field = make(2, 3, (3,), 3).double()
    rest = positions(4, field).double().requires_grad_()
    parameters = list(field.parameters())
    names = [name for name, _ in field.named_parameters()]

    def outputs(rest, *values):
        return torch.func.functional_call(field, dict(zip(names, values)), (rest, 0.4))

    # Positions enter the planes detached, so their gradient is checked with a field that does not look at them.
    assert torch.autograd.gradcheck(lambda *values: outputs(rest.detach(), *values), parameters, eps=1e-6, atol=1e-7)


def test_displacement_gradients_match_central_differences():
    generator = torch.Generator().manual_seed(4)
    heads = torch.randn(5, 10, generator=generator, dtype=torch.float64)
    rest = torch.randn(5, 3, generator=generator, dtype=torch.float64)
    centre = torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64)
    inputs = (heads.requires_grad_(), rest.requires_grad_())
    assert torch.autograd.gradcheck(lambda h, r: tuple(displace(h, r, centre, 0.7)), inputs, eps=1e-6, atol=1e-8)


def test_displacement_kernel_matches_float64_where_only_some_outputs_are_used():
    generator = torch.Generator().manual_seed(5)
    heads, rest = torch.randn(40, 10, generator=generator), torch.randn(40, 3, generator=generator)
    heads[0, 3:7] = torch.tensor([-1.0, 0, 0, 0])  # a quaternion of norm zero
    centre = torch.tensor([0.3, -0.2, 0.1])
    for used in range(3):
        results = []
        for dtype in (torch.float32, torch.float64):
            h, r = heads.to(dtype).requires_grad_(), rest.to(dtype).requires_grad_()
            out = displace(h, r, centre.to(dtype), 0.7)[used]
            seed = torch.randn(out.shape, generator=torch.Generator().manual_seed(6)).to(dtype)
            results.append(
                (
                    out,
                    *(
                        torch.zeros_like(x) if g is None else g
                        for g, x in zip(torch.autograd.grad(out, (h, r), seed, allow_unused=True), (h, r))
                    ),
                )
            )
        for a, b in zip(*results):
            assert torch.isfinite(a).all()
            assert (a - b)[1:].norm() <= 3e-6 * b[1:].norm() + 1e-12


def test_an_untrained_field_moves_nothing():
    field = DeformationField(torch.zeros(3), torch.ones(3), 5)
    rest = torch.rand(50, 3)
    dx, dr, ds = field(rest, 0.3)
    assert not dx.any() and not ds.any() and torch.equal(dr, torch.tensor([1.0, 0, 0, 0]).expand(50, 4))


def test_no_points_are_no_error():
    field = make()
    out = field(torch.zeros(0, 3, requires_grad=True), 0.2)
    assert [tuple(o.shape) for o in out] == [(0, 3), (0, 4), (0, 3)]
    assert all(not g.any() for g in torch.autograd.grad(sum(o.sum() for o in out), list(field.parameters())))


def test_bit_equal_for_any_number_of_threads_and_run():
    field = make(16, 64, (16, 32), 6)
    rest = positions(7000, field).requires_grad_()
    before = torch.get_num_threads()
    results = []
    try:
        for threads in (1, 2, 4, 2, 1):
            torch.set_num_threads(threads)
            out = field(rest, 0.3)
            results.append([*out, *torch.autograd.grad(sum(o.square().sum() for o in out), [rest, *field.parameters()])])
    finally:
        torch.set_num_threads(before)
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other))


def test_second_derivatives_are_a_clear_error():
    field = make()
    out = field(positions(5, field), 0.2).dx
    (grad,) = torch.autograd.grad(out.square().sum(), [field.head.bias], create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        grad.sum().backward()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a.update(points=torch.ones(5, 2)), r"points must be \[N,3\]"),
        (lambda a: a.update(time=[torch.ones(3, 2, 5, 2)]), "time must be"),
        (lambda a: a.update(out=torch.ones(5, 3)), r"out must be \[5,2\]"),
        (lambda a: a.update(space=[]), "levels"),
        (lambda a: a.update(weights=[torch.ones(4, 2)] * 3), "weights must be"),
        (lambda a: a.update(space=[torch.ones(3, 4, 4, 65)], time=[torch.ones(3, 2, 4, 65)]), "number of channels"),
    ],
)
def test_wrong_shapes_are_refused(change, message):
    arguments = {
        "space": [torch.ones(3, 4, 4, 2)],
        "time": [torch.ones(3, 2, 4, 2)],
        "weights": [],
        "points": torch.ones(5, 3),
        "out": torch.ones(5, 2),
    }
    change(arguments)
    a, box = arguments, ((0.0,) * 3, (1.0,) * 3)
    with pytest.raises(ValueError, match=message):
        _kernels.field_forward(a["space"], a["time"], a["weights"], a["points"], box, 0.0, a["out"], None, 1)
