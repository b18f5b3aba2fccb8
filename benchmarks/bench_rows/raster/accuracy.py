"""Image and gradients of the kernels against the float64 reference, on scenes of ordinary size and on hard ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from e4dgs.rasterizer import Frame
from e4dgs.rasterizer.reference.compare import cotangents, gradients, relative_l2
from e4dgs.rasterizer.reference.scene import Scene
from e4dgs.workflows.bench.rows import Bench, Check, Measured
from e4dgs.workflows.bench.scenes import cloud, convexes, mixed
from rasterizer.thresholds import decided_by_threshold
from torch import Tensor

from ..scenes import reconstructed_convexes

IMAGE_BAR, GRADIENT_BAR = 2e-5, 1e-4
COUNT, WIDTH, HEIGHT = 300, 120, 80


def measure(bench: Bench) -> Measured:
    width, height = bench.size(WIDTH, HEIGHT)
    n = bench.count(COUNT, 10)
    bench.expect(len(SCENES))
    worst_image, worst_gradient = ("", 0.0), ("", 0.0)
    numbers, table = {}, []
    for name, make in SCENES.items():
        scene = make(n, width, height)
        decided = decided_by_threshold(scene)
        image, by_name = errors(scene, decided)
        hardest = max(by_name, key=lambda field: by_name[field])
        left_out = float(decided.double().mean())
        numbers[name] = {"image": image, "gradients": by_name, "pixels_decided_by_a_threshold": left_out}
        worst_image = max(worst_image, (name, image), key=lambda found: found[1])
        worst_gradient = max(worst_gradient, (f"{name}, {hardest}", by_name[hardest]), key=lambda found: found[1])
        table.append((name, f"{image:.1e}", f"{by_name[hardest]:.1e}", hardest, f"{100 * left_out:.2f} %"))
        bench.tick(name)
    return Measured(
        protocol=f"{n} primitives, {width}x{height}, every output and every input's gradient; pixels that a threshold decides are left out",
        checks=[
            Check("largest error of an image", worst_image[1], IMAGE_BAR, unit="", note=worst_image[0]),
            Check("largest error of a gradient", worst_gradient[1], GRADIENT_BAR, unit="", note=f"relative L2; {worst_gradient[0]}"),
        ],
        numbers=numbers,
        columns=("scene", "image", "gradient", "of", "left out"),
        table=table,
    )


def errors(scene: Scene, decided: Tensor, backend: str = "cpu") -> tuple[float, dict[str, float]]:
    """Of a backend against the reference: largest error of an image outside the pixels ``decided`` [H, W], and each gradient's."""
    with torch.no_grad():
        got, want = scene.render(backend), scene.to(torch.float64).render("reference")
    weights = cotangents(want, ignore=decided)
    exact = gradients(scene.to(torch.float64), "reference", weights)
    ours = gradients(scene, backend, weights)
    return image_error(got, want, decided), {name: relative_l2(ours[name], value) for name, value in exact.items()}


def image_error(got: Frame, want: Frame, decided: Tensor) -> float:
    """The largest difference of color, alpha, depth and extras, each relative to its largest value (at least 1)."""
    worst = 0.0
    for name in ("color", "alpha", "depth", "extras"):
        a, b = getattr(got, name).double(), getattr(want, name).double()
        if b.numel() and not bool(decided.all()):
            worst = max(worst, float((a - b)[~decided].abs().max()) / max(1.0, float(b.abs().max())))
    return worst


def large_gaussians(n: int, width: int, height: int) -> Scene:
    return cloud(n, width, height, degree=3, size=0.15)


def large_convexes(n: int, width: int, height: int) -> Scene:
    """Six times as large about their centroids and as much softer, so that few of them fill the image."""
    scene = convexes(n, width, height)
    shapes = scene.convexes
    assert shapes is not None
    centroids = shapes.points.mean(1, keepdim=True)
    points = 0.6 * centroids + 6 * (shapes.points - centroids)
    return replace(scene, convexes=replace(shapes, points=points, tau=shapes.tau / 6, kappa=shapes.kappa / 6))


def surface_convexes(n: int, width: int, height: int) -> Scene:
    return reconstructed_convexes(n, width, height)


def both_kinds(n: int, width: int, height: int) -> Scene:
    return mixed(n, width, height, extras=2)


def needles(n: int, width: int, height: int) -> Scene:
    """Gaussians of axes 1 : 1e-5 in every direction."""
    scene = cloud(n, width, height, size=0.15)
    assert scene.gaussians is not None
    scales = scene.gaussians.scales.clone()
    scales[:, 1:] = 1e-5 * scales[:, :1]
    return replace(scene, gaussians=replace(scene.gaussians, scales=scales))


SCENES: dict[str, Callable[[int, int, int], Scene]] = {
    "Gaussians, SH 3": large_gaussians,
    "convexes": large_convexes,
    "convexes of a reconstruction": surface_convexes,
    "both kinds, extras": both_kinds,
    "needles": needles,
}
