"""Many layers at one pixel: transmittance is a long product in float32, and the backward pass divides it back."""

import pytest
import torch
from e4dgs.rasterizer import Convexes
from rasterizer.compare import assert_images_close, decided_by_threshold
from rasterizer.kernels import needs_cpu
from rasterizer.scenes import F64, Scene, generator, stack, uniform

from .against_reference import IMAGE, check_gradients

pytestmark = needs_cpu


def convex_stack(count: int, opacity: float, sharpness: float = 30.0) -> Scene:
    """The same pixel behind `count` squares, by default so large and sharp that M is 1 there."""
    scene = stack(1, opacity)
    z = torch.linspace(2.0, 6.0, count, dtype=F64)
    square = torch.tensor([[-1.0, -1, 0], [0.8, -1, 0], [0.7, 1.1, 0], [-1, 1.2, 0]], dtype=F64)
    points = square.repeat(count, 1, 1)
    points[..., 2] = z[:, None]
    sharp = torch.full((count,), sharpness, dtype=F64)
    colors = uniform(generator(6), 0, 1, count, 3)
    return Scene(scene.camera, None, Convexes(points, sharp, sharp, torch.full_like(z, opacity), colors=colors), scene.background)


def mixed_stack(count: int, opacity: float, sharpness: float = 30.0) -> Scene:
    """Gaussians and convexes in turn, each pair at one depth."""
    half = count // 2
    return Scene(stack(1, opacity).camera, stack(half, opacity).gaussians, convex_stack(half, opacity, sharpness).convexes, torch.ones(3))


STACKS = {"gaussians": lambda count, opacity, _=0: stack(count, opacity), "convexes": convex_stack, "mix": mixed_stack}


@pytest.mark.parametrize("kind", STACKS)
@pytest.mark.parametrize(("count", "opacity"), [(1000, 0.99), (10_000, 0.004)])
def test_stacks_of_1000_at_0_99_and_10_000_at_0_004(instruction_set: str, kind: str, count: int, opacity: float) -> None:
    if kind != "gaussians" and count > 1000:
        count = 3000  # 2301 of them are blended; the reference takes its time over each hull
    single = STACKS[kind](count, opacity).to(torch.float32)
    want, got = single.render("reference"), single.render("cpu")
    # 0.99 is the cap and 0.004 near the cut: whether an opacity has a gradient is for rounding to say. All else is not.
    nothing = torch.zeros(1, 1, dtype=torch.bool)
    assert_images_close(got, want, nothing, tolerance=IMAGE)
    weights = {"color": torch.tensor([[[1.0, -2, 0.5]]]), "depth": torch.ones(1, 1)}
    check_gradients(single, weights, tuple(name for name in single.tensors() if name.endswith("colors") or name == "background"))


@pytest.mark.parametrize("kind", STACKS)
@pytest.mark.parametrize(("count", "opacity"), [(1000, 0.98), (3000, 0.0055), (1000, 0.3), (1000, 0.02)])
def test_every_gradient_of_a_stack(kind: str, count: int, opacity: float) -> None:
    single = STACKS[kind](count, opacity, 4.0).to(torch.float32)
    # The stop itself may fall one layer apart: 1e-4 of transmittance are left there. It is ruled out by the test of the images.
    assert_images_close(single.render("cpu"), single.render("reference"), decided_by_threshold(single), max_decided=1.0, max_flips=0)
    check_gradients(single, {"color": torch.tensor([[[1.0, -2, 0.5]]]), "alpha": torch.ones(1, 1), "depth": torch.ones(1, 1)})
