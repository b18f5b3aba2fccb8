"""Tools for comparing two renders: gradients of a scalar, and how far two of them are apart."""

from __future__ import annotations

import torch
from torch import Tensor

from ..types import Frame
from .scene import Scene

OUTPUTS = ("color", "alpha", "depth", "extras")


def cotangents(frame: Frame, ignore: Tensor | None = None, seed: int = 0, outputs: tuple[str, ...] = OUTPUTS) -> dict[str, Tensor]:
    """Reproducible random weights for a scalar loss on each output; zero at the pixels in `ignore` [H, W]."""
    g = torch.Generator().manual_seed(seed)
    found = {}
    for name in outputs:
        weights = torch.randn(getattr(frame, name).shape, generator=g, dtype=torch.float64)
        if ignore is not None:
            weights[ignore] = 0
        found[name] = weights
    return found


def weigh(frame: Frame, weights: dict[str, Tensor]) -> Tensor:
    """The scalar sum over all outputs of weights * output, in the precision of the outputs."""
    return torch.stack([(getattr(frame, name) * w.to(getattr(frame, name).dtype)).sum() for name, w in weights.items()]).sum()


def gradients(scene: Scene, backend: str, weights: dict[str, Tensor]) -> dict[str, Tensor]:
    """Gradients of `weigh` with respect to every input of the scene; a gradient of None becomes zeros."""
    leaves = scene.leaves()
    weigh(scene.having(leaves).render(backend), weights).backward()
    return {name: torch.zeros_like(leaf) if leaf.grad is None else leaf.grad for name, leaf in leaves.items()}


def relative_l2(got: Tensor, want: Tensor) -> float:
    """|got - want| / |want| in float64. If want is zero: 0 if got is zero too, else infinity."""
    a, b = got.detach().double(), want.detach().double()
    size, distance = float(b.norm()), float((a - b).norm())
    return distance / size if size else (0.0 if distance == 0 else float("inf"))
