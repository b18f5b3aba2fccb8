"""Rows of `e4dgs bench raster`: images of Gaussians and of convexes, without and with gradients."""

from __future__ import annotations

from ...rasterizer.reference.scene import Scene
from .render import both, forward
from .rows import Bench, Measured
from .scenes import CONVEX_COUNT, GARDEN_SIZE, convexes, garden
from .threads import over_threads


def garden_row(bench: Bench) -> Measured:
    return _image(bench, *garden(bench))


def convexes_row(bench: Bench) -> Measured:
    count, (width, height) = bench.count(CONVEX_COUNT), bench.size(*GARDEN_SIZE)
    return _image(bench, convexes(count, width, height), f"{count:,} convexes of 6 points, {width}x{height}")


def _image(bench: Bench, scene: Scene, name: str) -> Measured:
    return over_threads(bench, name, {"forward": forward(scene), "forward + backward": both(scene)})
