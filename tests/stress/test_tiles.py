"""Tiles against brute force: the reference evaluates every primitive at every pixel. And one convex at several resolutions."""

import pytest
import torch
from rasterizer.compare import decided_by_threshold
from rasterizer.kernels import needs_cpu
from rasterizer.scenes import Scene, one_convex, prism, random_scene

from .against_reference import check

pytestmark = needs_cpu

SCENES = {
    "small, on many tiles": {"gaussians": 250, "convexes": 80, "size": 0.07, "width": 67, "height": 50, "spread": 1.3},
    "large, over many tiles": {"gaussians": 40, "convexes": 20, "size": 1.5, "width": 67, "height": 50},
    "beside the image": {"gaussians": 100, "convexes": 50, "spread": 5.0, "width": 50, "height": 35},
    "a strip": {"gaussians": 60, "convexes": 30, "width": 130, "height": 3},
    "a column": {"gaussians": 60, "convexes": 30, "width": 3, "height": 130},
}


@pytest.mark.parametrize("options", SCENES.values(), ids=SCENES.keys())
def test_tiled_against_brute_force(instruction_set: str, options: dict) -> None:  # type: ignore[type-arg]
    check(random_scene(40, degree=1, extras=1, **options))


PENTAGON = [[-0.5, -0.4], [0.5, -0.45], [0.6, 0.2], [0.1, 0.5], [-0.55, 0.3]]


def at_resolution(scale: float) -> Scene:
    """The same convex, 0.5 to 4 times the pixels along each side; pixel centres scale about the corner of the image."""
    scene = one_convex(prism(PENTAGON), tau=25.0, kappa=30.0, width=round(24 * scale), height=round(16 * scale))
    base = one_convex(prism(PENTAGON), width=24, height=16).camera.K
    scene.camera.K[:] = torch.diag(torch.tensor([scale, scale, 1.0], dtype=base.dtype)) @ base
    return scene.to(torch.float32)


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0, 4.0])
def test_a_convex_at_0_5_to_4_times_the_resolution(scale: float) -> None:
    check(at_resolution(scale))


def test_sharpness_does_not_depend_on_resolution() -> None:
    """The band in which alpha rises from 0.2 to 0.7 covers the same share of the image; in pixels it is eight times wider."""
    shares = []
    for scale in (0.5, 1.0, 2.0, 4.0):
        alpha = at_resolution(scale * 8).render("cpu").alpha
        shares.append(float(((alpha > 0.2) & (alpha < 0.7)).float().mean()))
    assert min(shares) > 0.02
    assert max(shares) - min(shares) < 0.05 * max(shares), shares


@pytest.mark.parametrize("every", [2, 3, 4])
def test_pixels_that_look_along_one_ray_agree_at_any_resolution(every: int) -> None:
    """The kernels' version of the reference's test in test_hull.py, to rounding in float32."""
    scene = random_scene(41, convexes=6, degree=None, width=19, height=14).to(torch.float32)

    def at(scale: int) -> Scene:
        K = scene.camera.K.clone()
        K[:2, :2] *= scale
        K[:2, 2] = scale * (K[:2, 2] - 0.5) + 0.5
        view = scene.having({"K": K})
        view.camera.width, view.camera.height = 19 * scale, 14 * scale
        return view

    decided = decided_by_threshold(at(1))
    difference = (at(every).render("cpu").color[::every, ::every] - at(1).render("cpu").color).abs().amax(-1)
    assert float(difference[~decided].max()) <= 2e-5
    assert float(decided.double().mean()) < 0.05
