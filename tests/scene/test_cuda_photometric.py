"""The GPU's image terms, under the emulator, against the CPU's kernel and plain float64."""

import pytest
import torch
from e4dgs.rasterizer.cuda.runtime import launcher_for, launching
from e4dgs.scene.cuda.photometric import photometric_loss
from e4dgs.scene.losses import photometric
from e4dgs.scene.losses.photometric import ssim_reference
from simt import CHECKED, RACES, Emulator, needs_compiler

pytestmark = needs_compiler
SIZES = [(1, 1), (5, 3), (16, 16), (33, 17), (40, 50), (8, 32), (9, 33), (2, 70)]  # a tile is 8 x 32
WEIGHTS = [(1.0, 0.0), (0.0, 1.0), (0.8, 0.2)]


def images(height, width, seed=0):
    generator = torch.Generator().manual_seed(seed)
    y = torch.rand(height, width, 3, generator=generator)
    return (y + 0.2 * torch.randn(y.shape, generator=generator)).clamp(0, 1), y


def exact(x, y, l1, ssim):
    return l1 * (x - y).abs().mean() + ssim * (1 - ssim_reference(x, y))


def run(x, y, l1=0.8, ssim=0.2, launcher=None):
    """Loss and gradient."""
    x = x.detach().requires_grad_()
    loss = photometric_loss(launcher or Emulator(), x, y, l1, ssim)
    (gradient,) = torch.autograd.grad(loss, x)
    return loss.detach(), gradient


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("weights", WEIGHTS, ids=str)
def test_value_and_gradient_are_those_of_the_cpu_and_of_float64(size, weights):
    x, y = images(*size)
    loss, gradient = run(x, y, *weights)
    there = x.double().requires_grad_()
    want = exact(there, y.double(), *weights)
    (want_gradient,) = torch.autograd.grad(want, there)
    assert abs(float(loss) - float(want.detach())) <= 2e-7
    assert (gradient - want_gradient).norm() <= 1e-6 * want_gradient.norm()
    on_cpu = x.clone().requires_grad_()
    theirs = photometric.photometric_loss(on_cpu, y, *weights)
    theirs.backward()
    assert abs(float(loss) - float(theirs.detach())) <= 2e-7
    assert (gradient - on_cpu.grad).norm() <= 1e-6 * want_gradient.norm()


def test_the_gradient_is_the_slope_of_the_loss():
    """Central differences of the reference, in float64, at every number of an image of two tiles."""
    x, y = (image.double() for image in images(5, 34, seed=1))
    assert (x - y).abs().min() > 2e-6  # no kink of L1 within a step
    _, gradient = run(x.float(), y.float(), 0.3, 0.7)
    slopes = torch.empty(x.numel(), dtype=torch.float64)
    step = 1e-6
    for i in range(x.numel()):
        ends = []
        for sign in (1, -1):
            moved = x.clone().view(-1)
            moved[i] += sign * step
            ends.append(0.3 * (moved.view(x.shape) - y).abs().mean() + 0.7 * (1 - ssim_reference(moved.view(x.shape), y)))
        slopes[i] = (ends[0] - ends[1]) / (2 * step)
    assert (gradient.view(-1) - slopes).abs().max() <= 1e-6 * slopes.abs().max()


@pytest.mark.parametrize("size", [(1, 1), (33, 17)], ids=str)
@pytest.mark.parametrize("contrast", [1.0, 0.0])
def test_equal_images_have_no_loss_and_no_gradient(size, contrast):
    y = 0.7 + contrast * (images(*size)[1] - 0.7)
    loss, gradient = run(y.clone(), y)
    assert abs(float(loss)) <= 2e-8 and gradient.abs().max() * y.numel() <= 1e-4


def test_a_small_loss_keeps_its_digits():
    _, y = images(40, 50)
    x = y + 1e-3 * torch.randn(y.shape, generator=torch.Generator().manual_seed(4))
    loss, _ = run(x, y, 0.0, 1.0)
    want = exact(x.double(), y.double(), 0.0, 1.0)
    assert 1e-6 < float(want) < 1e-4 and abs(float(loss) - float(want)) <= 1e-3 * float(want)


def test_bit_equal_in_any_order_of_threads():
    x, y = images(33, 40)
    loss, gradient = run(x, y)
    for launcher in (Emulator(1), Emulator(2), Emulator(3, CHECKED), Emulator(4, RACES)):
        now, gradient_now = run(x, y, launcher=launcher)
        assert torch.equal(now, loss) and torch.equal(gradient_now, gradient)


def test_gradients_scale_with_what_the_loss_is_used_for():
    x, y = images(16, 16)
    loss, gradient = run(x, y)
    x.requires_grad_()
    (3 * photometric_loss(Emulator(), x, y, 0.8, 0.2) + x.sum()).backward()
    torch.testing.assert_close(x.grad, 3 * gradient + 1, rtol=1e-6, atol=0)
    alone = photometric_loss(Emulator(), x.detach(), y, 0.8, 0.2)
    assert torch.equal(alone, loss) and not alone.requires_grad


def test_images_may_have_any_strides():
    x, y = images(9, 33)
    loss, gradient = run(x, y)
    planar, mirrored = x.permute(2, 0, 1).contiguous().permute(1, 2, 0), y.flip(1).contiguous().flip(1)
    assert not planar.is_contiguous()
    now, gradient_now = run(planar, mirrored)
    assert torch.equal(now, loss) and torch.equal(gradient_now, gradient)


def test_what_is_not_a_number_reaches_the_loss_and_its_surroundings():
    x, y = images(20, 40)
    x[3, 5, 1] = torch.nan
    loss, gradient = run(x, y)
    assert loss.isnan()
    bad = gradient.isnan()
    assert bad[:14, :16, 1].all() and not bad[..., [0, 2]].any() and not bad[14:].any() and not bad[:, 16:].any()


def test_wrong_arguments_are_refused():
    for first, second in (((4, 4, 3), (4, 5, 3)), ((0, 4, 3), (0, 4, 3)), ((4, 4), (4, 4))):
        with pytest.raises(ValueError, match=r"\[H, W, 3\]"):
            photometric_loss(Emulator(), torch.ones(first), torch.ones(second), 0.8, 0.2)
    with pytest.raises(ValueError, match="float64"):
        photometric_loss(Emulator(), torch.ones(4, 4, 3), torch.ones(4, 4, 3).double(), 0.8, 0.2)


class OnGpu(torch.Tensor):
    """A tensor of the CPU that says it lies on a GPU."""

    @property
    def device(self):
        return torch.device("cuda", 0)


class Pretending(Emulator):
    def launch(self, program, kernel, blocks, threads, *arguments):
        plain = (a.as_subclass(torch.Tensor) if isinstance(a, torch.Tensor) else a for a in arguments)
        super().launch(program, kernel, blocks, threads, *plain)


def test_the_loss_is_computed_where_its_images_lie(monkeypatch):
    x, y = images(5, 3)
    loss, gradient = run(x, y)
    there = x.as_subclass(OnGpu).requires_grad_()
    monkeypatch.setattr(photometric._kernels, "photometric", None)
    monkeypatch.setattr(photometric, "ssim_reference", None)
    with launching("cuda", Pretending()):
        value = photometric.photometric_loss(there, y.as_subclass(OnGpu))
        (found,) = torch.autograd.grad(value, there)
    assert torch.equal(value.detach().as_subclass(torch.Tensor), loss) and torch.equal(found.as_subclass(torch.Tensor), gradient)


@pytest.mark.cuda
@pytest.mark.parametrize("size", [*SIZES, (211, 333)], ids=str)
def test_on_a_gpu_value_and_gradient_are_those_of_the_cpu(size):
    x, y = images(*size)
    there = x.cuda().requires_grad_()
    loss = photometric.photometric_loss(there, y.cuda())
    loss.backward()
    here = x.clone().requires_grad_()
    want = photometric.photometric_loss(here, y)
    want.backward()
    assert loss.device == there.device and abs(float(loss.detach()) - float(want.detach())) <= 5e-7
    assert (there.grad.cpu() - here.grad).norm() <= 2e-6 * here.grad.norm()


@pytest.mark.cuda
def test_on_a_gpu_a_graph_repeats_loss_and_gradient():
    x, y = (image.cuda() for image in images(40, 50))
    launcher = launcher_for(x.device)
    want, want_gradient = run(x, y, launcher=launcher)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        loss, gradient = run(x, y, launcher=launcher)
    graph.replay()
    assert torch.equal(loss, want) and torch.equal(gradient, want_gradient)
