"""`appearance_loss` of any device and type, and inputs for the tests of its kernels on the CPU and on the GPU."""

from types import SimpleNamespace

import torch
from e4dgs.scene.losses.appearance import appearance_loss
from e4dgs.scene.settings import TrainingSettings

SETTINGS = TrainingSettings(l1_weight=0.7, ssim_weight=0.3, alpha_weight=0.5)
BACKGROUND = (0.1, 0.0, 0.9)
SHARE = 0.6


def given(size, parts, seed=0):
    """Named inputs: `image`, `target`, and what belongs to ``parts``."""
    draw = torch.Generator().manual_seed(seed)
    target = torch.rand(*size, 3, generator=draw)
    known = torch.rand(size, generator=draw)
    weight = 4 * torch.rand(size, generator=draw)
    weight[weight < 1] = 0
    kept = torch.rand(size, generator=draw) < 0.7
    all_of_them = {
        "image": (target + 0.2 * torch.randn(target.shape, generator=draw)).clamp(0, 1),
        "target": target,
        "gain": torch.tensor([1.2, 0.9, 1.05]),
        "offset": torch.tensor([0.03, -0.02, 0.01]),
        "alpha": (known + 0.2 * torch.randn(size, generator=draw)).clamp(0, 1),
        "known": known,
        "kept": kept,
        "weight": weight * kept if "kept" in parts else weight,
    }
    names = (
        {"image", "target", *parts} | ({"gain", "offset"} if "recording" in parts else set()) | ({"known"} if "alpha" in parts else set())
    )
    return {name: p for name, p in all_of_them.items() if name in names}


def outcome(run, inputs):
    """The loss, and the gradients of three times it."""
    leaves = {name: inputs[name].detach().clone().requires_grad_() for name in ("image", "alpha", "gain", "offset") if name in inputs}
    loss = run(**(inputs | leaves))
    grads = torch.autograd.grad(3 * loss, list(leaves.values()))
    return {"loss": loss.detach()} | dict(zip(leaves, grads))


def composed(image, target, alpha=None, known=None, kept=None, weight=None, gain=None, offset=None):
    """`appearance_loss` of whatever device and type the image has."""
    frame = SimpleNamespace(color=image, alpha=alpha)
    recording = None if gain is None else (gain, offset)
    rendered = SimpleNamespace(frame=frame, target=target, kept=kept, weight=weight, recording=recording, share=SHARE)
    return appearance_loss(rendered, SETTINGS, BACKGROUND, known)


def exactly(inputs):
    return outcome(composed, {name: p.double() if p.is_floating_point() else p for name, p in inputs.items()})


def assert_close(found, expected):
    assert found.keys() == expected.keys()
    assert abs(float(found["loss"]) - float(expected["loss"])) <= 3e-7
    for name, value in expected.items():
        assert (found[name] - value).norm() <= 2e-6 * value.norm() + 1e-9, name
