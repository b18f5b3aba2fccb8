"""The device that `pretending_cuda` pretends behaves as CUDA does where code may get it wrong."""

import copy
from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from e4dgs.scene import _kernels
from pretend_cuda import Pretended, pretending_cuda

THERE = torch.device("cuda", 0)


@pytest.fixture
def pretending():
    with pretending_cuda() as found:
        yield found


def is_there(x):
    """By every name that Python has for it."""
    assert x.is_cuda == (x.device == THERE) == (x.device.type == "cuda") == (x.get_device() == 0) == isinstance(x, Pretended)
    assert x.is_cpu != x.is_cuda and not x.is_meta
    return x.is_cuda


def waits(pretending, do):
    """What `do` waits for."""
    before = len(pretending.syncs)
    do()
    return [sync.what for sync in pretending.syncs[before:]]


def here(n=3):
    return torch.arange(1.0, n + 1)


def test_what_is_asked_for_there_is_there(pretending):
    x, g = here(), torch.Generator().manual_seed(0)
    made = [
        *(x.cuda(), x.to("cuda"), x.to(0), x.to(THERE, torch.float64), x.to(device="cuda", dtype=torch.int64, non_blocking=True)),
        *(x.to(torch.zeros(1, device="cuda")), torch.from_numpy(np.ones(3)).to("cuda:0"), torch.randint(9, (3,), generator=g).to("cuda")),
        *(make(3, device="cuda") for make in (torch.zeros, torch.ones, torch.empty, torch.rand, torch.randn, torch.arange, torch.eye)),
        *(torch.full((3,), 2, device=THERE), torch.linspace(0, 1, 3, device="cuda"), torch.randint(4, (3,), device="cuda")),
        *(torch.randperm(3, device="cuda"), torch.tensor([1, 2], device="cuda"), torch.as_tensor(np.ones(2), device="cuda")),
        *(torch.asarray([1], device="cuda"), torch.zeros_like(x, device="cuda"), torch.empty(0, 3, device="cuda")),
        *(x.new_zeros(3, device="cuda"), x.new_tensor([3], device="cuda")),
    ]
    assert all(map(is_there, made))
    y = x.cuda()
    same = [torch.zeros_like(y), torch.rand_like(y), y.new_zeros(2), y.new_tensor([1]), y.new_full((2,), 3), y[1:], y + 1, y.detach()]
    assert all(map(is_there, [*same, y.data, torch.tensor(y), torch.nn.Parameter(y), y.sort().indices, y > 1, copy.deepcopy(y)]))
    assert isinstance(torch.nn.Parameter(y), torch.nn.Parameter)
    assert not any(map(is_there, [x, y.cpu(), y.to("cpu"), y.to(x), torch.zeros_like(y, device="cpu"), y.new_zeros(2, device="cpu")]))
    assert y.to("cuda") is y and y.cuda() is y and y.to(THERE, torch.float32) is y
    assert "device='cuda:0'" in repr(y) and f"{y[0]:.2f}" == "1.00" and y.tolist() == [1, 2, 3] and len(y) == 3
    with torch.device("cuda"):
        assert all(map(is_there, [torch.ones(2), torch.tensor([1.0]), torch.as_tensor([1]), torch.tensor(x), torch.asarray(x)]))
    with pytest.raises(RuntimeError, match="invalid device ordinal"):
        x.to("cuda:1")


def test_copies_share_no_memory(pretending):
    x = here()
    y = x.cuda()
    z = y.cpu()
    y += 10
    assert x.tolist() == z.tolist() == [1, 2, 3] and y.tolist() == [11, 12, 13]
    y[:2].unsqueeze_(0).mul_(2)
    assert y.tolist() == [22, 24, 13]


@pytest.mark.parametrize(
    "mix",
    [
        lambda cpu, gpu, i, m: cpu + gpu,
        lambda cpu, gpu, i, m: cpu * gpu[0],
        lambda cpu, gpu, i, m: torch.zeros(3) + gpu,
        lambda cpu, gpu, i, m: gpu == cpu,
        lambda cpu, gpu, i, m: gpu[None] @ cpu[:, None],
        lambda cpu, gpu, i, m: torch.cat([cpu, gpu]),
        lambda cpu, gpu, i, m: torch.stack([cpu[0], gpu[0]]),
        lambda cpu, gpu, i, m: torch.where(gpu > 1, cpu, gpu),
        lambda cpu, gpu, i, m: torch.where(cpu > 1, gpu, gpu),
        lambda cpu, gpu, i, m: gpu.masked_fill(m, 0.0),
        lambda cpu, gpu, i, m: gpu.index_add(0, i, gpu),
        lambda cpu, gpu, i, m: gpu.index_select(0, i),
        lambda cpu, gpu, i, m: gpu.gather(0, i),
        lambda cpu, gpu, i, m: torch.zeros_like(gpu).scatter_add_(0, i, gpu),
        lambda cpu, gpu, i, m: cpu[i.cuda()],
        lambda cpu, gpu, i, m: cpu[m.cuda()],
        lambda cpu, gpu, i, m: gpu.index_put_((i,), cpu),
        lambda cpu, gpu, i, m: cpu.add_(gpu),
        lambda cpu, gpu, i, m: cpu[0].add_(gpu[0]),
        lambda cpu, gpu, i, m: torch.add(gpu, gpu, out=cpu),
        lambda cpu, gpu, i, m: torch.equal(cpu, gpu),
        lambda cpu, gpu, i, m: F.mse_loss(gpu, cpu),
        lambda cpu, gpu, i, m: F.conv1d(gpu[None, None], cpu[None, None]),
        lambda cpu, gpu, i, m: F.embedding(i, gpu[:, None]),
        lambda cpu, gpu, i, m: torch.nn.Linear(3, 2)(gpu),
    ],
)
def test_tensors_of_two_devices_do_not_mix(pretending, mix):
    i = torch.tensor([2, 0, 1])
    with pytest.raises(RuntimeError, match=r"same device|indices should be"):
        mix(here(), here().cuda(), i, i > 0)


def test_what_cuda_lets_mix(pretending):
    x, i, m = here().cuda(), torch.tensor([2, 0]), torch.tensor([True, False, True])
    two = torch.tensor(2.0)
    assert all(map(is_there, [x * two, two - x, torch.where(x > 1, two, x), x.masked_fill(x > 1, two), x.clamp(max=two), x[i], x[m]]))
    assert x[i].tolist() == [3, 1] and x[m].tolist() == [1, 3] and (x * two).tolist() == [2, 4, 6]
    assert x[[2, 0]].tolist() == x[np.array([2, 0])].tolist() == x[(2, 0),].tolist() == [3, 1] and x[[True, False, False]].tolist() == [1]
    x[0] = 5
    x[i] = two
    x[x == 5] = 7.0
    x[1:] = torch.tensor([8.0, 9.0])
    assert x.tolist() == [2, 8, 9]
    y = here()
    y[0], y[1:2] = x[1], x[2:]
    y[m] = x[0]
    assert not is_there(y) and y.tolist() == [2, 9, 2]
    assert y.copy_(x) is y and x.copy_(y) is x and not is_there(y)
    assert torch.tensor([x[0], 1.0]).tolist() == [2, 1] and [0, 1, 2][i.cuda()[0]] == 2


def test_a_generator_of_the_cpu_is_refused(pretending):
    g = torch.Generator()
    for make in (lambda: torch.randn(3, generator=g, device="cuda"), lambda: here().cuda().normal_(generator=g)):
        with pytest.raises(RuntimeError, match="Expected a 'cuda' device type for generator"):
            make()


def test_nothing_leaves_torch_unseen(pretending):
    x = here(6).cuda().view(3, 2)
    for leave in (lambda: x.numpy(), lambda: np.asarray(x), lambda: np.linalg.norm(x)):
        with pytest.raises(TypeError, match="can't convert cuda:0 device type tensor to numpy"):
            leave()
    assert x.numpy(force=True).shape == x.cpu().numpy().shape == (3, 2)
    with pytest.raises(TypeError):  # kernels of the CPU take no such tensors
        _kernels.adam([(x, x, x, x, None, None, 1, 0.1)], 0.9, 0.99, 1e-15, 1)
    with pytest.raises(TypeError):
        _kernels.adam([(here(6).view(3, 2), x, x, x, None, None, 1, 0.1)], 0.9, 0.99, 1e-15, 1)


@pytest.mark.parametrize(
    ("what", "do"),
    [
        ("item", lambda x: x[0].item()),
        ("item", lambda x: float(x.sum())),
        ("item", lambda x: bool((x > 0).all())),
        ("item", lambda x: [7, 8, 9, 10][x.long()[0]]),
        ("item", lambda x: f"{x[0]:.3f}"),
        ("tolist", lambda x: x.tolist()),
        ("nonzero", lambda x: x.nonzero()),
        ("nonzero", lambda x: torch.where(x > 1)),
        ("mask", lambda x: x[x > 1]),
        ("mask", lambda x: x.index_put_((x > 1,), x[:1])),
        ("masked_select", lambda x: x.masked_select(x > 1)),
        ("download", lambda x: x.cpu()),
        ("download", lambda x: torch.empty(3).copy_(x)),
        ("upload", lambda x: torch.ones(3).cuda()),
        ("upload", lambda x: torch.tensor(1.0, device="cuda")),
        ("upload", lambda x: x[torch.tensor([0, 1])]),
        ("upload", lambda x: x[[0, 1]]),
        ("upload", lambda x: x.copy_(torch.ones(3))),
        ("equal", lambda x: torch.equal(x, x)),
        ("_unique2", lambda x: torch.unique(x)),
        ("repeat_interleave", lambda x: x.repeat_interleave(x.long())),
        ("synchronize", lambda x: torch.cuda.synchronize()),
        (None, lambda x: torch.ones(3).to("cuda", non_blocking=True)),
        (None, lambda x: x.copy_(torch.ones(3), non_blocking=True)),
        (None, lambda x: x.to("cuda").to(torch.float64).to(x)),
        (None, lambda x: x[1:].add_(2).sum() + torch.tensor(3.0)),
        (None, lambda x: x.__setitem__(x > 1, 0.0)),
        (None, lambda x: x.index_select(0, x.argsort()[:2])),
        (None, lambda x: torch.zeros(5, device="cuda")),
        (None, lambda x: x.repeat_interleave(x.long(), output_size=6)),
    ],
)
def test_what_waits_is_noted(pretending, what, do):
    x = here().cuda()
    assert waits(pretending, lambda: do(x)) == ([] if what is None else [what])
    assert not pretending.syncs or Path(pretending.syncs[-1].where.split(":")[0]).name == Path(__file__).name


def test_an_event_happens_behind_the_host(pretending):
    first, second = torch.cuda.Event(), torch.cuda.Event(enable_timing=False)
    for event in (first, second):
        event.record(torch.cuda.current_stream())
    assert waits(pretending, lambda: [first.query(), first.query(), first.synchronize()]) == []
    assert first.query() and not second.query()
    assert waits(pretending, second.synchronize) == ["synchronize"] and second.query()
    first.record()
    assert not first.query()


def test_torch_is_as_before_afterwards():
    before = torch.cuda.is_available(), torch.tensor, torch.Tensor.to, torch.cuda.synchronize
    with pretending_cuda(), pytest.raises(ZeroDivisionError):
        assert torch.cuda.is_available() and torch.cuda.device_count() == 1 and torch.cuda.current_device() == 0
        assert torch.cuda.mem_get_info()[0] > 0 and not torch.cuda.is_current_stream_capturing()
        x = torch.zeros(3, device="cuda")
        raise ZeroDivisionError
    assert (torch.cuda.is_available(), torch.tensor, torch.Tensor.to, torch.cuda.synchronize) == before
    assert x.cpu().tolist() == [0, 0, 0] and not is_there(torch.zeros(3))
