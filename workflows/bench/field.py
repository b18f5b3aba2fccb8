"""Rows of `e4dgs bench field`: the deformation field, the image loss and the optimiser, as training runs them, with gradients."""

from __future__ import annotations

import torch

from ...scene.losses.photometric import photometric_loss
from ...scene.motion.planes.field import DeformationField
from ...scene.training.optimiser import RowAdam
from .rows import Bench, Measured
from .threads import over_threads
from .timing import Run

TIMES, RESOLUTIONS, CHANNELS = 50, (16, 32), (16, 32)
SHAPES = {"means": (3,), "quats": (4,), "log_scales": (3,), "opacity_logits": (), "sh_dc": (1, 3), "sh_rest": (15, 3)}  # 59 a Gaussian


def field_row(bench: Bench) -> Measured:
    n, generator = bench.count(30_000, 64), torch.Generator().manual_seed(1)
    rest, weights = 2 * torch.rand(n, 3, generator=generator) - 1, [torch.randn(n, width, generator=generator) for width in (3, 4, 3)]

    def passing(channels: int) -> Run:
        field = DeformationField(torch.full((3,), -1.0), torch.full((3,), 1.0), TIMES, RESOLUTIONS, channels, 64, seed=3)
        with torch.no_grad():  # the head starts at zero, through which no gradient would flow back
            field.head.weight += 0.05 * torch.randn(field.head.weight.shape, generator=generator)
        parameters = list(field.parameters())
        return lambda: torch.autograd.grad(list(field(rest, 0.37)), parameters, weights)

    what = f"{n:,} points, levels of {' and '.join(map(str, RESOLUTIONS))}, {TIMES} times, MLP of width 64"
    return over_threads(bench, what, {f"{channels} channels": passing(channels) for channels in CHANNELS})


def loss_row(bench: Bench) -> Measured:
    width, height = bench.size(400, 400)
    target, image = torch.rand(2, height, width, 3, generator=torch.Generator().manual_seed(2))
    leaf = image.requires_grad_()
    run = {"0.8 L1 + 0.2 (1 - SSIM)": lambda: torch.autograd.grad(photometric_loss(leaf, target, 0.8, 0.2), leaf)}
    return over_threads(bench, f"{width}x{height}, and the gradient by the image", run)


def adam_row(bench: Bench) -> Measured:
    n, generator = bench.count(30_000, 100), torch.Generator().manual_seed(3)
    parameters = {name: torch.randn(n, *shape, generator=generator).requires_grad_() for name, shape in SHAPES.items()}
    adam = RowAdam(dict(parameters), {name: lambda progress: 1e-3 for name in SHAPES}, (0.9, 0.99))
    gradients = {name: 1e-4 * torch.randn(p.shape, generator=generator) for name, p in parameters.items()}

    def step() -> None:
        for name, p in parameters.items():
            p.grad = gradients[name]
        adam.step(0.0)

    return over_threads(bench, f"59 parameters each of {n:,} Gaussians, six tensors", {"a step": step})
