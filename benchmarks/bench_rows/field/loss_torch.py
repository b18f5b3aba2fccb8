"""L1 + SSIM, value and gradient, against separable convolutions in torch, and both against float64."""

from __future__ import annotations

from collections.abc import Callable

import torch
from e4dgs.rasterizer.reference.compare import relative_l2
from e4dgs.scene.losses.photometric import photometric_loss, ssim_reference
from e4dgs.workflows.bench.rows import Bench, Check, Measured
from e4dgs.workflows.bench.timing import interleaved, ratio
from torch import Tensor

from ..curves import Curve, Plotted
from ..peers.loss import torch_loss

SIZE = 400
L1, SSIM = 0.8, 0.2
BAR = 5.0
ERROR_BARS = {"value": 1e-5, "gradient": 1e-4}  # what the rasterizer's gradients promise too


def measure(bench: Bench) -> Measured:
    width, height = bench.size(SIZE, SIZE)
    target, image = images(width, height)
    contenders = {"ours": photometric_loss, "torch": torch_loss}
    times = interleaved(bench, {name: pass_over(loss, image, target) for name, loss in contenders.items()}, 2 * bench.repeats)
    value, note = ratio(times["torch"], times["ours"])
    truth = outcome(oracle, image.double(), target.double())
    errors = {}
    for name, loss in contenders.items():
        got = outcome(loss, image, target)
        errors[name] = {"value": abs(float(got[0]) / float(truth[0]) - 1), "gradient": relative_l2(got[1], truth[1])}
    checks = [Check("torch's time over ours", value, BAR, "above", note=note)]
    for what in ("value", "gradient"):
        note = f"relative{' L2' if what == 'gradient' else ''}; of torch's {errors['torch'][what]:.1e}"
        checks.append(Check(f"error of the {what} against float64", errors["ours"][what], ERROR_BARS[what], unit="", note=note))
    return Plotted(
        protocol=f"{width}x{height}, {L1} L1 + {SSIM} (1 - SSIM), forward + backward to the image; {torch.get_num_threads()} threads",
        checks=checks,
        numbers={"times": {name: t.json() for name, t in times.items()}, "errors": errors},
        curves=[Curve("loss", name, [1e3 * t.best], [errors[name]["gradient"]], "ms", "relative error") for name, t in times.items()],
        columns=("", "best ms", "median ms"),
        table=[(name, f"{1e3 * t.best:.2f}", f"{1e3 * t.median:.2f}") for name, t in times.items()],
    )


def images(width: int, height: int) -> tuple[Tensor, Tensor]:
    """A target with edges and shades, and an image that is near it as a render is."""
    generator = torch.Generator().manual_seed(7)
    y, x = torch.meshgrid(torch.linspace(0, 1, height), torch.linspace(0, 1, width), indexing="ij")
    shade = torch.stack([x, y, 0.5 + 0.5 * torch.sin(20 * x * y)], -1)
    target = torch.where(((8 * x).floor() + (8 * y).floor())[..., None] % 2 > 0, shade, 1 - shade)
    return target, (target + 0.05 * torch.randn(target.shape, generator=generator)).clamp(0, 1)


def oracle(image: Tensor, target: Tensor, l1: float = L1, ssim: float = SSIM) -> Tensor:
    return l1 * (image - target).abs().mean() + ssim * (1 - ssim_reference(image, target))


def outcome(loss: Callable[..., Tensor], image: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Value, and gradient by the image."""
    leaf = image.clone().requires_grad_()
    value = loss(leaf, target, L1, SSIM)
    return value.detach(), torch.autograd.grad(value, leaf)[0]


def pass_over(loss: Callable[..., Tensor], image: Tensor, target: Tensor) -> Callable[[], object]:
    leaf = image.clone().requires_grad_()
    return lambda: torch.autograd.grad(loss(leaf, target, L1, SSIM), leaf)
