"""What a (pixel, convex) pair costs, in units of a (pixel, Gaussian) pair."""

from __future__ import annotations

from dataclasses import replace

import torch
from e4dgs.rasterizer import Convexes, Gaussians
from e4dgs.rasterizer.reference.scene import Scene
from e4dgs.workflows.bench.render import both, forward
from e4dgs.workflows.bench.rows import Bench, Check, Measured
from e4dgs.workflows.bench.scenes import CONVEX_COUNT, convexes, garden
from e4dgs.workflows.bench.timing import Timing, interleaved

from ..native.counts import Pairs, count_pairs
from ..scenes import reconstructed_convexes

BAR = 3.0
PASSES = ("forward", "forward + backward")


def measure(bench: Bench) -> Measured:
    width, height = bench.size(648, 420)
    m = bench.count(CONVEX_COUNT)
    bench.expect(3)
    scenes: dict[str, Scene] = {}
    for name, make in (("synthetic", convexes), ("reconstruction", reconstructed_convexes)):
        scenes[f"{name} convexes"] = make(m, width, height)
        scenes[f"{name} Gaussians"] = counterpart(scenes[f"{name} convexes"])
        bench.tick(name)
    scenes["garden's Gaussians"] = garden(bench)[0]
    pairs = {name: count_pairs(scene) for name, scene in scenes.items()}
    bench.tick("pairs")
    runs = {f"{name}, {what}": run for name, scene in scenes.items() for what, run in zip(PASSES, (forward(scene), both(scene)))}
    times = interleaved(bench, runs)

    def cost(name: str, what: str, best: bool = True) -> float:
        timing = times[f"{name}, {what}"]
        return 1e9 * (timing.best if best else timing.median) / pairs[name].blended

    def share(name: str) -> float:
        """Of the visible pairs, those that are blended. Behind its stop a pixel costs nothing, so the bar is for these."""
        return pairs[name].blended / pairs[name].visible

    checks = []
    for name in ("synthetic", "reconstruction"):
        for what in PASSES:
            ours, theirs = f"{name} convexes", f"{name} Gaussians"
            note = f"{cost(ours, what, False) / cost(theirs, what, False):.2f}x by medians"
            checks.append(
                Check(f"{name}, {what}, a convex's pair over a Gaussian's", cost(ours, what) / cost(theirs, what), BAR, note=note)
            )
            visible = cost(ours, what) / cost(theirs, what) * share(ours) / share(theirs)
            checks.append(Check(f"{name}, {what}, the same by visible pairs", visible))
            against = cost(ours, what) / cost("garden's Gaussians", what)
            checks.append(Check(f"{name}, {what}, over a pair of garden's Gaussians", against))
    return Measured(
        protocol=f"{m:,} convexes of 6 points and as many Gaussians of the same centres, extents, opacities and colours, {width}x{height}; "
        f"a pair is a pixel and a primitive that it blends; {torch.get_num_threads()} threads",
        checks=checks,
        numbers={
            "pairs": {name: vars(count) for name, count in pairs.items()},
            "times": {name: timing.json() for name, timing in times.items()},
        },
        columns=("", "M pairs visible", "M blended", "forward ms", "ns a pair", "both ms", "ns a pair"),
        table=[_cells(name, pairs[name], [times[f"{name}, {what}"] for what in PASSES]) for name in scenes],
    )


def counterpart(scene: Scene) -> Scene:
    """Gaussians with the convexes' centroids, opacities, colours, and the covariance of each one's points, all enlarged by the one factor
    that makes as many pairs visible."""
    shapes = scene.convexes
    assert shapes is not None
    wanted = count_pairs(scene).visible
    gaussians = covering(shapes)
    factor = 1.0
    for _ in range(4):
        enlarged = Scene(scene.camera, replace(gaussians, scales=gaussians.scales * factor), None, scene.background)
        found = count_pairs(enlarged).visible
        if not found or not wanted or abs(found / wanted - 1) < 0.02:
            break
        factor *= (wanted / found) ** 0.5
    return enlarged


def covering(shapes: Convexes) -> Gaussians:
    """One Gaussian a convex: mean and covariance of its points."""
    centroids = shapes.points.mean(1)
    arms = (shapes.points - centroids[:, None]).double()
    variances, axes = torch.linalg.eigh(arms.mT @ arms / shapes.points.shape[1])
    axes = axes * torch.linalg.det(axes).sign()[:, None, None]
    return Gaussians(centroids, quats_of(axes).float(), variances.clamp(min=1e-12).sqrt().float(), shapes.opacities, colors=shapes.colors)


def quats_of(rotations: torch.Tensor) -> torch.Tensor:
    """[n, 4] w x y z of rotations [n, 3, 3]: the eigenvector to the largest eigenvalue of Bar-Itzhack's symmetric matrix."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = (row.unbind(-1) for row in rotations.unbind(-2))
    rows = [
        [xx + yy + zz, zy - yz, xz - zx, yx - xy],
        [zy - yz, xx - yy - zz, xy + yx, xz + zx],
        [xz - zx, xy + yx, yy - xx - zz, yz + zy],
        [yx - xy, xz + zx, yz + zy, zz - xx - yy],
    ]
    return torch.linalg.eigh(torch.stack([torch.stack(row, -1) for row in rows], -2))[1][..., -1]


def _cells(name: str, pairs: Pairs, times: list[Timing]) -> tuple[str, ...]:
    costs = [cell for t in times for cell in (f"{1e3 * t.best:.1f}", f"{1e9 * t.best / max(pairs.blended, 1):.2f}")]
    return (name, f"{pairs.visible / 1e6:.2f}", f"{pairs.blended / 1e6:.2f}", *costs)
