"""Operators give the same numbers and gradients under `pretending_cuda`, also those that torch has written for a device by itself."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from pretend_cuda import pretending_cuda

torch.manual_seed(0)
GIVEN = {
    "a": torch.randn(4, 5),
    "b": torch.randn(5),
    "i": torch.tensor([2, 0, 1, 3]),
    "m": torch.randn(4, 5) > 0,
    "s": torch.rand(4, 4) + 4 * torch.eye(4),
    "x": torch.randn(1, 3, 8, 8),
    "w": torch.randn(2, 3, 3, 3),
}
OPERATORS = """
a[[0, 2]]; a[np.array([0, 2])]; a[:, [1, 2]]; a[[0, 1], [1, 2]]; a[[True, False, True, False]]; a[i]; a[m]; a[i[:, None], i]; a[i[0], 1:]
a[..., None, 1:3]; a[(0, 1)]; a[[]]; torch.where(m, a, 0.0); torch.where(m, 1.0, a); torch.where(m)[0]; m.nonzero(as_tuple=True)[1]
torch.tensor([a[0, 0], 2.0]); a.new_tensor([1, 2.0]); a.new_full((2,), 3.0); torch.full_like(a, 2.0); torch.as_tensor(a); a @ a.T
torch.einsum("ij,kj->ik", a, a); torch.addmm(s, s, s); torch.cdist(a, a); a.norm(dim=1); a.std(); a.var(0); a.quantile(0.3)
torch.linalg.inv(s); torch.linalg.solve(s, a); torch.linalg.eigh(s @ s.T)[0]; torch.linalg.svd(s)[1]; torch.linalg.det(s)
torch.linalg.matrix_exp(s); a.cumsum(1); a.sort(dim=1).values; a.topk(2).values; a.median(); a.kthvalue(2).values; a.argmax(1)
torch.unique(i); torch.bincount(i); torch.histc(a, 4, -1, 1); torch.searchsorted(b.sort().values, a); a.masked_select(m); a.max(0).values
a.index_add(0, i, a); a.index_copy(0, i, a); a.gather(1, i[:, None]); a.scatter_add(0, i[:, None].expand(4, 5), a); a.masked_fill(m, 1.0)
torch.zeros_like(a).scatter_(1, i[:, None], 1.0); a.repeat_interleave(2, 0); a.repeat_interleave(i, 0); a.roll(1, 0).flip(1)
a.diff(dim=0); F.conv2d(x, w, padding=1); F.interpolate(x, scale_factor=2.0, mode="bilinear")
F.grid_sample(x, x[:, :2].movedim(1, -1), align_corners=False); F.avg_pool2d(x, 2); F.max_pool2d(x, 2)
F.pad(x, (1, 1, 1, 1), mode="reflect"); F.unfold(x, 3); F.instance_norm(x); F.layer_norm(a, (5,)); F.softmax(a, 1); F.normalize(a)
F.one_hot(i); F.linear(a, b); F.embedding(i, s); F.huber_loss(a, 0.2 * a); F.cross_entropy(s, i); a.split([1, 3])[1]; a.chunk(2)[1]
a.unbind(0)[2]; a.T.contiguous().view(-1); a.double().half().float(); a.type(torch.int64); a.view(torch.int32); 1 - a; a**2; 2**a.abs()
a.detach() // 2; a % 2; ~m & m; torch.atan2(a, a); torch.maximum(a, 0 * a); torch.lerp(a, 2 * a, 0.3); torch.nan_to_num(a / 0)
torch.stack([a, a]).sum(0); torch.cat([a, a[:0]]); torch.meshgrid(b, b, indexing="ij")[0]; torch.diag_embed(b)
torch.cross(a[:, :3], a[:, 1:4], 1); torch.vmap(lambda r: r.square().sum())(a); torch.fft.rfft(a).abs(); np.float32(2) * a; sum(a)
"""


@pytest.mark.parametrize("what", [each.strip() for each in OPERATORS.replace("\n", ";").split(";") if each.strip()])
@pytest.mark.filterwarnings("ignore")
def test_operators_give_the_same_numbers_and_gradients(what):
    def ask(device):
        given = {name: t.to(device, copy=True) for name, t in GIVEN.items()}
        leaves = [t.requires_grad_() for t in given.values() if t.is_floating_point()]
        found = eval(what, {"torch": torch, "np": np, "F": F}, given)
        assert found.device == torch.device(device) or what.startswith("torch.tensor(")
        grads = torch.autograd.grad(found.sum(), leaves, allow_unused=True) if found.requires_grad else ()
        assert all(g is None or g.device == torch.device(device) for g in grads)
        return [None if t is None else t.detach().cpu() for t in (found, *grads)]

    want = ask("cpu")
    with pretending_cuda():
        got = ask("cuda:0")
    for here, there in zip(want, got, strict=True):
        assert (here is None) == (there is None)
        if here is not None:
            torch.testing.assert_close(there, here, rtol=1e-5, atol=1e-5, equal_nan=True)
