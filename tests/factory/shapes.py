"""Shapes with closed-form ray intersections, each in its own frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Surface(NamedTuple):
    """Texture coordinates [N,2] in the shape's units, face index [N], outward normal [N,3]."""

    uv: Array
    face: NDArray[np.int64]
    normal: Array


@dataclass(frozen=True)
class Box:
    """An axis-aligned box of half sizes `half`; with `inside` it is a room that is seen from within."""

    half: tuple[float, float, float]
    inside: bool = False

    def intersect(self, origin: Array, directions: Array) -> Array:
        """Ray parameter of the first visible hit [N], inf where there is none (slab method)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1.0 / directions
            a, b = (-np.asarray(self.half) - origin) * inverse, (np.asarray(self.half) - origin) * inverse
            near = np.nanmax(np.minimum(a, b), axis=-1)
            far = np.nanmin(np.maximum(a, b), axis=-1)
        t = far if self.inside else near
        return np.where((near <= far) & (t > 1e-9), t, np.inf)

    def surface(self, points: Array) -> Surface:
        """Texture coordinates of points [N,3] on the box: the two coordinates that span the face."""
        scaled = points / np.asarray(self.half)
        axis = np.argmax(np.abs(scaled), axis=-1)
        rows = np.arange(len(points))
        sign = np.sign(scaled[rows, axis])
        normal = np.zeros_like(points)
        normal[rows, axis] = -sign if self.inside else sign
        uv = np.stack([points[rows, (axis + 1) % 3], points[rows, (axis + 2) % 3]], axis=-1)
        return Surface(uv, 2 * axis + (sign > 0), normal)


@dataclass(frozen=True)
class Sphere:
    """A sphere around the origin; its texture runs along longitude and latitude, in units of arc length at the equator."""

    radius: float

    def intersect(self, origin: Array, directions: Array) -> Array:
        """Ray parameter of the first hit from outside [N], inf where there is none."""
        a = np.sum(directions * directions, axis=-1)
        b = directions @ origin
        c = origin @ origin - self.radius**2
        discriminant = b * b - a * c
        # c / (-b + root) instead of (-b - root) / a: no cancellation for spheres that are far away.
        with np.errstate(divide="ignore", invalid="ignore"):
            t = c / (-b + np.sqrt(np.maximum(discriminant, 0.0)))
        return np.where((discriminant > 0) & (t > 1e-9) & (c > 0), t, np.inf)

    def surface(self, points: Array) -> Surface:
        """Texture coordinates of points [N,3] on the sphere."""
        normal = points / np.linalg.norm(points, axis=-1, keepdims=True)
        longitude = np.arctan2(normal[:, 1], normal[:, 0])
        latitude = np.arcsin(np.clip(normal[:, 2], -1.0, 1.0))
        return Surface(self.radius * np.stack([longitude, latitude], axis=-1), np.zeros(len(points), np.int64), normal)


Shape = Box | Sphere
