"""Gradients on images that are wider than high and higher than wide, by central differences.

The differences are taken of the reference, in float64, so that they are exact to 1e-6; both the reference's gradients and the kernels'
are held against them. Pixels that a threshold decides somewhere on the way have no weight.
"""

import pytest
import torch
from rasterizer.compare import cotangents, decided_by_threshold, gradients, weigh
from rasterizer.kernels import needs_cpu
from rasterizer.scenes import F64, Scene, generator, random_scene

from .against_reference import GRADIENT

pytestmark = needs_cpu

STEP = 1e-6
DIRECTIONS = 6
SIZES = {"wide": (31, 11), "tall": (9, 29)}


def read(name: str, direction: torch.Tensor) -> torch.Tensor:
    """Zero where the renderer does not read: all of K but fx, fy, cx, cy, and the last row of cam_from_world."""
    if name == "K":
        return direction * torch.tensor([[1.0, 0, 1], [0, 1, 1], [0, 0, 0]], dtype=F64)
    return direction * torch.tensor([1.0, 1, 1, 0], dtype=F64)[:, None] if name == "cam_from_world" else direction


@pytest.mark.parametrize("mode", ["default", "antialiased", "near plane"])
@pytest.mark.parametrize("points", [3, 8])
@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES.keys())
def test_central_differences_where_width_and_height_differ(size: tuple[int, int], points: int, mode: str) -> None:
    width, height = size
    # Near the middle, since the clamp of the Jacobian's slopes moves with K and carries no gradient by contract.
    # Rounded to float32 first, so that reference and kernels start from the same numbers.
    options = {"points": points, "degree": 2, "extras": 1, "width": width, "height": height, "antialiased": mode != "default"}
    single = random_scene(50, 7, 5, spread=0.4, size=0.35 if mode == "default" else 0.2, **options).to(torch.float32)
    if mode == "near plane":  # some Gaussians fade, some convexes are clipped
        assert single.gaussians is not None
        single.gaussians.means.mul_(0.1)
        single.camera.cam_from_world[:3, 3] = torch.tensor([0.0, 0.0, 0.6])
        single.camera.near = 0.3
    scene: Scene = single.to(F64)
    decided = decided_by_threshold(scene, alpha_band=1e-4, stop_band=1e-2, depth_band=1e-4)
    assert float(decided.double().mean()) < 0.1
    weights = cotangents(scene.render(), ignore=decided)
    exact, ours = gradients(scene, "reference", weights), gradients(single, "cpu", weights)
    for name, value in scene.tensors().items():
        g = generator(51)
        numeric, along = [], []
        for _ in range(DIRECTIONS):
            direction = read(name, torch.randn(value.shape, generator=g, dtype=F64))
            direction = direction / direction.norm()
            ahead, behind = (scene.having({name: value + sign * STEP * direction}).render() for sign in (1, -1))
            numeric.append(float(weigh(ahead, weights) - weigh(behind, weights)) / (2 * STEP))
            along.append([float((found[name].double() * direction).sum()) for found in (exact, ours)])
        differences, (theirs, mine) = torch.tensor(numeric, dtype=F64), torch.tensor(along, dtype=F64).T
        size_of = float(differences.norm())
        assert size_of > 0, name
        assert float((theirs - differences).norm()) <= 1e-5 * size_of, f"{name}: the reference against differences"
        assert float((mine - differences).norm()) <= GRADIENT * size_of, f"{name}: the kernels against differences"
