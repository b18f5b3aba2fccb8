"""The two operations of a rasterizer that are timed: an image without gradients, and one with gradients of all fields of the primitives."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ...rasterizer import Camera, Convexes, Frame, Gaussians, rasterize
from ...rasterizer.reference.scene import Scene

Rasterize = Callable[[Camera, Gaussians | None, Convexes | None, Tensor | None], Frame]


def forward(scene: Scene, with_: Rasterize = rasterize) -> Callable[[], Frame]:
    """Renders ``scene`` without gradients."""

    def run() -> Frame:
        with torch.no_grad():
            return with_(scene.camera, scene.gaussians, scene.convexes, scene.background)

    return run


def both(scene: Scene, with_: Rasterize = rasterize) -> Callable[[], tuple[Tensor, ...]]:
    """Renders ``scene`` and computes the gradient of the sum of its colours with respect to every field of its primitives."""
    leaves = scene.primitive_leaves()
    attached = scene.having(leaves)
    ones = torch.ones(scene.camera.height, scene.camera.width, 3)

    def run() -> tuple[Tensor, ...]:
        frame = with_(attached.camera, attached.gaussians, attached.convexes, attached.background)
        return torch.autograd.grad(frame.color, list(leaves.values()), ones, allow_unused=True)

    return run
