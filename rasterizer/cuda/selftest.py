"""Checks that the CUDA kernels give the same results as the CPU kernels on this machine. Run once before the GPU is used.

    python -m e4dgs.rasterizer.cuda.selftest

Compares the images and gradients of a small scene with both kinds of primitive. Exit code 0, or 1 with one line about what is wrong.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import torch
from torch import Tensor

from .. import Camera, Convexes, Gaussians, rasterize

WIDTH, HEIGHT = 40, 24
Results = Callable[[], dict[str, Tensor]]
LIMIT = 1e-3  # relative L2 distance of images and of each gradient; leaves room for a pixel or two on a threshold


def problem(device: str) -> str | None:
    """One line about what is wrong with backend "cuda" on this device, or None if nothing is."""
    return disagreement(lambda: _results("cpu", "cpu"), lambda: _results("cuda", device))


def disagreement(on_cpu: Results, on_device: Results) -> str | None:
    """One line about what the device computes otherwise than the CPU, or why it does not compute at all; None if the results agree.

    on_cpu, on_device: compute the same values, by names for people.
    """
    try:
        want, got = on_cpu(), on_device()
    except Exception as cause:  # any failure is the answer
        return f"the CUDA kernels do not run here: {type(cause).__name__}: {str(cause).splitlines()[0] if str(cause) else ''}"
    if missing := want.keys() ^ got.keys():
        return f"the CUDA kernels compute something else than the CPU's: only one of them has {min(missing)}"
    for name, value in want.items():
        distance = float((got[name].cpu() - value).norm() / value.norm().clamp(min=1e-12))
        if not distance <= LIMIT:
            return f"the CUDA kernels compute something else than the CPU's: {name} is off by {distance:.1e}, more than {LIMIT:.0e}"
    return None


def _results(backend: str, device: str) -> dict[str, Tensor]:
    g = torch.Generator().manual_seed(1)

    def leaf(*shape: int, low: float, high: float) -> Tensor:
        return (low + (high - low) * torch.rand(shape, generator=g)).to(device).requires_grad_()

    gaussians = Gaussians(
        leaf(40, 3, low=-1, high=1), leaf(40, 4, low=0.1, high=1), leaf(40, 3, low=0.05, high=0.3), leaf(40, low=0.2, high=0.8),
        sh=leaf(40, 4, 3, low=-0.5, high=0.5),
    )  # fmt: skip
    convexes = Convexes(
        leaf(8, 6, 3, low=-0.8, high=0.8), leaf(8, low=8, high=20), leaf(8, low=8, high=20), leaf(8, low=0.2, high=0.8),
        colors=leaf(8, 3, low=0, high=1),
    )  # fmt: skip
    pose = torch.eye(4)
    pose[2, 3] = 4.0
    camera = Camera(torch.tensor([[40.0, 0, WIDTH / 2], [0, 40, HEIGHT / 2], [0, 0, 1]]), pose, WIDTH, HEIGHT)
    frame = rasterize(camera, gaussians, convexes, backend=backend)  # type: ignore[arg-type]
    weights = torch.linspace(0.1, 1, WIDTH, device=device)
    loss = (frame.color.sum(-1) * weights).sum() + (frame.alpha * weights).sum() + 0.1 * (frame.depth * weights).sum()
    leaves = {
        f"{kind}.{name}": value for kind, owner in (("gaussians", gaussians), ("convexes", convexes)) for name, value in vars(owner).items()
    }
    leaves = {name: value for name, value in leaves.items() if value is not None}
    gradients = torch.autograd.grad(loss, list(leaves.values()))
    images = {name: getattr(frame, name).detach() for name in ("color", "alpha", "depth")}
    return images | {f"the gradient of {name}": gradient for name, gradient in zip(leaves, gradients)}


if __name__ == "__main__":
    found = problem("cuda")
    print(found or "the CUDA kernels agree with the CPU's")
    sys.exit(found is not None)
