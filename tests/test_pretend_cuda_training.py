"""Under `pretending_cuda`, gradients, modules and the rasterizer stay on the device, and render what the emulator renders elsewhere."""

import copy
import threading
from collections import Counter
from dataclasses import fields, replace
from typing import ClassVar

import pytest
import torch
import torch.nn.functional as F
from e4dgs.rasterizer import rasterize
from e4dgs.rasterizer.cuda.runtime import launcher_for, launching
from pretend_cuda import pretending_cuda
from rasterizer.scenes import random_scene
from simt import Emulator, needs_compiler

OUTPUTS = ("color", "alpha", "depth", "extras")


@pytest.fixture
def pretending():
    with pretending_cuda() as found:
        yield found


def here():
    return torch.arange(1.0, 4.0)


class Cube(torch.autograd.Function):
    seen: ClassVar[list] = []

    @staticmethod
    def forward(ctx, x, y):
        ctx.save_for_backward(x, y)
        out = x.detach() * x.detach() * x.detach()
        Cube.seen += [x, y, out]
        return out

    @staticmethod
    def backward(ctx, grad):
        x, y = ctx.saved_tensors
        Cube.seen += [grad, x, y]
        return 3 * x * x * grad, None


def test_autograd_keeps_to_the_device(pretending):
    x, y = here().cuda().requires_grad_(), torch.nn.Parameter(here().cuda())
    assert x.is_leaf and x.to("cuda") is x
    Cube.seen = []
    before = len(pretending.syncs)
    (Cube.apply(x, y + 0) * y)[1:].sum().backward()
    assert len(Cube.seen) == 6 and all(t.is_cuda for t in [*Cube.seen, x.grad, y.grad]) and len(pretending.syncs) == before
    assert x.grad.tolist() == [0, 24, 81] and y.grad.tolist() == [0, 8, 27]
    cpu = here().requires_grad_()
    (cpu.cuda() * x.detach()).sum().backward()
    assert not cpu.grad.is_cuda and cpu.grad.tolist() == [1, 2, 3]
    assert torch.autograd.grad(x.cpu().square().sum(), x)[0].is_cuda
    with pytest.raises(RuntimeError, match="on the same device"):
        x.grad = torch.zeros(3)


def test_a_gradient_from_the_wrong_device_is_refused(pretending):
    class Wrong(Cube):
        @staticmethod
        def backward(ctx, grad):
            return torch.zeros(3), None

    x = here().cuda().requires_grad_()
    with pytest.raises(RuntimeError, match="invalid gradient"):
        Wrong.apply(x, x).sum().backward()


def test_modules_move_with_their_parameters(pretending):
    torch.manual_seed(0)
    module = torch.nn.Sequential(torch.nn.Linear(3, 4), torch.nn.BatchNorm1d(4), torch.nn.Linear(4, 1))
    twin, weight = copy.deepcopy(module), module[0].weight
    module.to("cuda")
    assert module[0].weight is weight and weight.is_cuda and isinstance(weight, torch.nn.Parameter) and module[1].running_mean.is_cuda
    x = torch.randn(5, 3)
    for net, data in ((module, x.cuda()), (twin, x)):
        for _ in range(2):
            net.zero_grad()
            net(data).square().sum().backward()
            torch.nn.utils.clip_grad_norm_(net.parameters(), 0.1)
            with torch.no_grad():
                for p in net.parameters():
                    p -= 0.1 * p.grad
    assert all(t.is_cuda for t in [weight.grad, *module.state_dict().values()])
    module.cpu()
    assert module[0].weight is weight and not weight.is_cuda
    for a, b in zip(module.state_dict().values(), twin.state_dict().values()):
        torch.testing.assert_close(a, b)
    module.cuda().load_state_dict(twin.state_dict())
    assert module[2].bias.is_cuda and torch.equal(module[2].bias.cpu(), twin[2].bias)


def test_threads_and_inference_mode_are_no_way_round(pretending):
    x, found = here().cuda(), []
    thread = threading.Thread(target=lambda: found.extend([x + 1, x.cpu()]))
    thread.start()
    thread.join()
    with torch.inference_mode():
        found += [F.linear(x, x[None]), x.to("cuda"), x.cpu()]
        with pytest.raises(RuntimeError, match="same device"):
            F.linear(x, torch.ones(1, 3))
    assert [y.is_cuda for y in found] == [True, False, True, True, False]


def tensors_of(owner):
    return [value for value in (getattr(owner, field.name) for field in fields(owner)) if isinstance(value, torch.Tensor)]


def moved(owner, device):
    """Leaves with these values on a device."""
    values = {f.name: getattr(owner, f.name) for f in fields(owner)}
    tensors = {name: v.detach().clone().to(device).requires_grad_() for name, v in values.items() if isinstance(v, torch.Tensor)}
    return replace(owner, **tensors)


def render(primitives="cpu", camera="cpu", backend="auto", pretending=None):
    """Image and gradients of a small scene, and what forward and backward waited for."""
    scene = random_scene(1, gaussians=12, convexes=5, extras=2).to(torch.float32)
    view, background = moved(scene.camera, camera), scene.background.to(camera).requires_grad_()
    kinds = moved(scene.gaussians, primitives), moved(scene.convexes, primitives)
    waits = []

    def noted():
        if pretending is not None:
            waits.append(Counter(sync.what for sync in pretending.syncs))
            pretending.syncs.clear()

    noted()
    frame = rasterize(view, *kinds, background, backend=backend)
    noted()
    g = torch.Generator().manual_seed(7)
    weights = {name: torch.randn(getattr(frame, name).shape, generator=g).to(primitives) for name in OUTPUTS}
    loss = sum((getattr(frame, name) * weights[name]).sum() for name in OUTPUTS)
    noted()
    loss.backward()
    noted()
    leaves = [*tensors_of(view), background, *(t for kind in kinds for t in tensors_of(kind))]
    for leaf in leaves:
        assert leaf.grad.device == leaf.device
    return tensors_of(frame), [leaf.grad for leaf in leaves], waits[1::2]


@needs_compiler
def test_what_is_rendered_there_is_what_the_emulator_renders(pretending):
    with launching("cpu", Emulator(0)):
        frame, grads, _ = render(backend="cuda")
    for camera in ("cpu", "cuda"):
        pretending.kernels.clear()
        there, grads_there, waits = render("cuda", camera, pretending=pretending)
        assert all(image.is_cuda for image in there)
        for got, want in zip([*there, *grads_there], [*frame, *grads]):
            assert torch.equal(got.cpu(), want)
        assert Counter(pretending.kernels)["blend_forward"] == Counter(pretending.kernels)["blend_backward"] == 1
        # The number of pairs; of a camera on the device its values and the background's are looked at as well, one wait each.
        assert waits[0] == ({"synchronize": 1} if camera == "cpu" else {"synchronize": 1, "tolist": 2})
        assert waits[1] == ({"download": 3} if camera == "cpu" else {})  # the gradients of K, cam_from_world and background


@needs_compiler
def test_primitives_that_stayed_behind_are_refused(pretending):
    scene = random_scene(1, gaussians=4).to(torch.float32)
    with pytest.raises(ValueError, match=r"gaussians\.means is on cpu, but the others are on cuda:0"):
        rasterize(moved(scene.camera, "cuda"), scene.gaussians)
    with pytest.raises(ValueError, match="move them with"):
        rasterize(moved(scene.camera, "cuda"), moved(scene.gaussians, "cuda"), backend="cpu")


def test_kernels_take_tensors_of_the_device_alone(pretending):
    class Recorder:
        def launch(self, program, kernel, blocks, threads, *arguments):
            arguments[0].add_(1)
            assert all(a is None or type(a) is torch.Tensor for a in arguments)

    with pretending_cuda(emulator=Recorder()) as inner:
        launcher, x = launcher_for(torch.device("cuda", 0)), torch.zeros(3, device="cuda")
        launcher.launch(None, "some", 1, 32, x, x[1:], None)
        with pytest.raises(ValueError, match=r"some: argument 1 .* is on cpu, the kernel runs on cuda:0"):
            launcher.launch(None, "some", 1, 32, x, torch.zeros(3))
        assert x.tolist() == [1, 1, 1] and inner.kernels == ["some"]
