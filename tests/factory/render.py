"""The ray caster: exact visibility, box-filtered supersampling, no approximation beyond the number of samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .camera import Camera

if TYPE_CHECKING:
    from .scene import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Truth:
    """What a camera sees: image [H,W,4] RGBA in [0,1] with straight alpha; depth [H,W] z at the pixel's centre, 0 where
    nothing is hit; object [H,W] index into `scene.objects`, -1 where nothing is hit; coverage [H,W,N], the share of every
    pixel that each object covers."""

    image: Array
    depth: Array
    object: NDArray[np.int64]
    coverage: Array

    def mask(self, index: int) -> NDArray[np.bool_]:
        """[H,W]: the pixels whose centre shows object `index`."""
        return self.object == index


class Hits(NamedTuple):
    """First hits of N rays: depth [N] (inf: none), object [N] (-1: none), the point in the object's frame [N,3]."""

    depth: Array
    object: NDArray[np.int64]
    local: Array


def cast(scene: Scene, time: float, origin: Array, directions: Array) -> Hits:
    """The nearest hit of rays from one origin [3] along directions [N,3]; depth is in units of the direction's length."""
    depth = np.full(len(directions), np.inf)
    index = np.full(len(directions), -1, np.int64)
    local = np.zeros_like(directions)
    for i, item in enumerate(scene.objects):
        object_from_world = np.linalg.inv(item.motion.world_from_object(time))
        start = object_from_world[:3, :3] @ origin + object_from_world[:3, 3]
        along = directions @ object_from_world[:3, :3].T
        t = item.shape.intersect(start, along)
        nearer = t < depth
        depth[nearer] = t[nearer]
        index[nearer] = i
        local[nearer] = start + t[nearer, None] * along[nearer]
    return Hits(depth, index, local)


def shade(scene: Scene, time: float, hits: Hits) -> Array:
    """Colours [N,3] of hits: texture times ambient and, by `scene.light`, Lambert's share of a fixed lamp."""
    colours = np.zeros((len(hits.depth), 3))
    lamp = np.asarray(scene.lamp) / np.linalg.norm(scene.lamp)
    for i, item in enumerate(scene.objects):
        chosen = hits.object == i
        if not chosen.any():
            continue
        surface = item.shape.surface(hits.local[chosen])
        normal_matrix = np.linalg.inv(item.motion.world_from_object(time)[:3, :3])  # row vectors: n @ A^-1 is A^-T n
        normal = surface.normal @ normal_matrix
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        lit = 1.0 - scene.light + scene.light * (0.5 + 0.5 * normal @ lamp)
        colours[chosen] = item.texture(surface.uv, surface.face) * lit[:, None]
    return colours


def render(scene: Scene, camera: Camera, time: float, samples: int = 4) -> Truth:
    """Render one view with samples x samples rays a pixel on a regular grid (box filter, the pixel's exact area)."""
    height, width, count = camera.height, camera.width, len(scene.objects)
    corner = camera.pixel_centres().reshape(-1, 2) - 0.5
    premultiplied = np.zeros((height * width, 3))
    coverage = np.zeros((height * width, count))
    for sy in range(samples):
        for sx in range(samples):
            origin, directions = camera.rays(corner + (np.array([sx, sy]) + 0.5) / samples)
            hits = cast(scene, time, origin, directions)
            premultiplied += shade(scene, time, hits)
            coverage += hits.object[:, None] == np.arange(count)
    premultiplied /= samples * samples
    coverage /= samples * samples
    alpha = coverage.sum(axis=-1, keepdims=True)
    colour = premultiplied / np.maximum(alpha, 1e-12)

    origin, directions = camera.rays(camera.pixel_centres().reshape(-1, 2))
    centre = cast(scene, time, origin, directions)
    return Truth(
        image=np.concatenate([colour, alpha], axis=-1).reshape(height, width, 4),
        depth=np.where(np.isfinite(centre.depth), centre.depth, 0.0).reshape(height, width),
        object=centre.object.reshape(height, width),
        coverage=coverage.reshape(height, width, count),
    )


def to_uint8(image: Array) -> NDArray[np.uint8]:
    """[0,1] to [0,255], rounded to nearest."""
    return np.round(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)
