"""The two things that are timed of a rasterizer: an image without gradients, and an image with gradients of every primitive's fields."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from ...rasterizer import Camera, Convexes, Frame, Gaussians, _cpu, rasterize  # type: ignore[attr-defined]
from ...rasterizer.reference.scene import Scene

Rasterize = Callable[[Camera, Gaussians | None, Convexes | None, Tensor | None], Frame]


@dataclass
class Pairs:
    """(pixel, primitive) pairs of a frame with alpha >= 1/255: all of them, and those in front of their pixel's stop; and how many
    (tile, primitive) pairs were distributed."""

    visible: int
    blended: int
    entries: int


def forward(scene: Scene, with_: Rasterize = rasterize) -> Callable[[], Frame]:
    """Renders ``scene`` without gradients."""

    def run() -> Frame:
        with torch.no_grad():
            return with_(scene.camera, scene.gaussians, scene.convexes, scene.background)

    return run


def both(scene: Scene, with_: Rasterize = rasterize) -> Callable[[], tuple[Tensor, ...]]:
    """Renders ``scene`` and takes the gradient of the sum of its colours by every field of its primitives."""
    leaves = scene.primitive_leaves()
    attached = scene.having(leaves)
    ones = torch.ones(scene.camera.height, scene.camera.width, 3)

    def run() -> tuple[Tensor, ...]:
        frame = with_(attached.camera, attached.gaussians, attached.convexes, attached.background)
        return torch.autograd.grad(frame.color, list(leaves.values()), ones, allow_unused=True)

    return run


def count_pairs(scene: Scene) -> Pairs:
    """Pairs of ``scene`` as our rasterizer sees them."""
    attached = scene.having(scene.primitive_leaves())
    frame = rasterize(attached.camera, attached.gaussians, attached.convexes, attached.background, backend="cpu")
    node = frame.color.grad_fn
    assert node is not None
    visible, blended = _cpu.count_pairs(node.kept, torch.get_num_threads())  # type: ignore[attr-defined]
    return Pairs(visible, blended, node.kept.entries)  # type: ignore[attr-defined]
