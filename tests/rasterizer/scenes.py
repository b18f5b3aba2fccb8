"""Small deterministic scenes for the rasterizer's tests, and a way to take their tensors out and put others in."""

from __future__ import annotations

from typing import Any

import torch
from e4dgs.rasterizer import Camera, Convexes, Gaussians
from e4dgs.rasterizer.reference.scene import Scene
from torch import Tensor

F64 = torch.float64


def generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def uniform(g: torch.Generator, low: float, high: float, *shape: int) -> Tensor:
    return low + (high - low) * torch.rand(shape, generator=g, dtype=F64)


def make_camera(width: int = 37, height: int = 23, seed: int = 0, focal: float = 1.1, distance: float = 4.0) -> Camera:
    """A camera `distance` in front of the world's origin, slightly turned, fx != fy, principal point off the middle."""
    g = generator(1000 + seed)
    size = max(width, height)
    K = torch.tensor([[focal * size, 0, 0.47 * width], [0, 1.13 * focal * size, 0.55 * height], [0, 0, 1]], dtype=F64)
    turn = torch.linalg.matrix_exp(skew(uniform(g, -0.3, 0.3, 3)))
    pose = torch.eye(4, dtype=F64)
    pose[:3, :3] = turn
    pose[:3, 3] = torch.tensor([0.1, -0.05, distance], dtype=F64)
    return Camera(K, pose, width, height)


def skew(v: Tensor) -> Tensor:
    x, y, z = v.tolist()
    return torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=F64)


def looks(g: torch.Generator, n: int, degree: int | None, extras: int | None) -> dict[str, Tensor]:
    """`sh` of this degree (bright enough not to be clamped everywhere) or, for None, `colors`; `extras` unless None."""
    found: dict[str, Tensor] = {}
    if degree is None:
        found["colors"] = uniform(g, -0.2, 1.2, n, 3)
    else:
        found["sh"] = 0.3 * torch.randn(n, (degree + 1) ** 2, 3, generator=g, dtype=F64)
    if extras is not None:
        found["extras"] = torch.randn(n, extras, generator=g, dtype=F64)
    return found


def random_gaussians(
    seed: int, n: int, degree: int | None = 3, extras: int | None = None, spread: float = 1.0, size: float = 0.35
) -> Gaussians:
    g = generator(2000 + seed)
    return Gaussians(
        means=uniform(g, -spread, spread, n, 3),
        quats=torch.randn(n, 4, generator=g, dtype=F64) * torch.exp(uniform(g, -1, 1, n, 1)),
        scales=size * torch.exp(uniform(g, -2, 0, n, 3)),
        opacities=uniform(g, 0.05, 1.0, n),
        **looks(g, n, degree, extras),
    )


def random_convexes(
    seed: int, m: int, points: int = 6, degree: int | None = 3, extras: int | None = None, spread: float = 1.0, size: float = 0.5
) -> Convexes:
    g = generator(3000 + seed)
    return Convexes(
        points=uniform(g, -spread, spread, m, 1, 3) + size * torch.randn(m, points, 3, generator=g, dtype=F64),
        tau=torch.exp(uniform(g, 1.5, 4.0, m)),
        kappa=torch.exp(uniform(g, 1.5, 4.0, m)),
        opacities=uniform(g, 0.2, 1.0, m),
        **looks(g, m, degree, extras),
    )


def random_scene(
    seed: int = 0,
    gaussians: int = 0,
    convexes: int = 0,
    points: int = 6,
    degree: int | None = 3,
    extras: int | None = None,
    width: int = 37,
    height: int = 23,
    spread: float = 1.0,
    size: float = 0.35,
    antialiased: bool = False,
) -> Scene:
    """Gaussians and convexes strewn about the world's origin in front of `make_camera`. float64; use `.to(torch.float32)` for cpu."""
    return Scene(
        make_camera(width, height, seed),
        random_gaussians(seed, gaussians, degree, extras, spread, size) if gaussians else None,
        random_convexes(seed, convexes, points, degree, extras, spread, 1.4 * size) if convexes else None,
        torch.tensor([0.2, 0.5, 0.8], dtype=F64),
        antialiased,
    )


def through_the_camera(seed: int = 0, **options: Any) -> Scene:
    """An antialiased scene in which many primitives lie at and behind the near plane, which is far out."""
    scene = random_scene(seed, antialiased=True, **options)
    scene.camera.cam_from_world[2, 3] = 0.5
    scene.camera.near = 0.25
    return scene


def prism(corners: list[list[float]], depth: float = 0.0) -> Tensor:
    """[1, K, 3] points at z = depth with these x, y."""
    return torch.tensor([[[x, y, depth] for x, y in corners]], dtype=F64)


def one_convex(points: Tensor, tau: float = 12.0, kappa: float = 15.0, opacity: float = 0.9, width: int = 21, height: int = 15) -> Scene:
    """One convex with these points [1, K, 3], seen from z = -4 without a turn."""
    camera = make_camera(width, height)
    camera.cam_from_world = torch.eye(4, dtype=F64)
    camera.cam_from_world[2, 3] = 4.0
    number = torch.ones(1, dtype=F64)
    colors = torch.tensor([[0.9, 0.4, 0.1]], dtype=F64)
    return Scene(camera, None, Convexes(points, tau * number, kappa * number, opacity * number, colors=colors), torch.zeros(3, dtype=F64))


def stack(count: int, opacity: float) -> Scene:
    """One pixel behind `count` broad Gaussians in a row, all of them with this opacity at the pixel's centre."""
    K = torch.tensor([[100.0, 0, 0.5], [0, 100.0, 0.5], [0, 0, 1]], dtype=F64)
    z = torch.linspace(2.0, 6.0, count, dtype=F64)
    zero = torch.zeros_like(z)
    quats = torch.tensor([1.0, 0, 0, 0], dtype=F64).repeat(count, 1)
    scales = torch.full((count, 3), 0.5, dtype=F64)
    colors = uniform(generator(5), 0, 1, count, 3)
    gaussians = Gaussians(torch.stack([zero, zero, z], 1), quats, scales, torch.full_like(z, opacity), colors=colors)
    return Scene(Camera(K, torch.eye(4, dtype=F64), 1, 1), gaussians, None, torch.zeros(3, dtype=F64))


def needles(seed: int = 0, n: int = 12) -> Scene:
    """Gaussians with axes 1 : 1e-6 and the reverse (plates), in every direction."""
    scene = random_scene(seed, gaussians=n, degree=None)
    assert scene.gaussians is not None
    scales = torch.full((n, 3), 1e-6, dtype=F64)
    scales[: n // 2, 0] = 1.0
    scales[n // 2 :, 1:] = 1.0
    return scene.having({"gaussians.scales": scales})
