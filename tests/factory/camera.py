"""A camera with OpenCV axes and OpenCV lens distortion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """K [3,3] px, cam_from_world [4,4], distortion (k1, k2, p1, p2[, k3, k4, k5, k6]) as in OpenCV's model, or (k1, k2, k3, k4) as in its
    fisheye model."""

    K: Array
    cam_from_world: Array
    width: int
    height: int
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    fisheye: bool = False

    @property
    def world_from_cam(self) -> Array:
        """[4,4], the exact inverse of a rigid transform."""
        rotation, translation = self.cam_from_world[:3, :3], self.cam_from_world[:3, 3]
        inverse = np.eye(4)
        inverse[:3, :3] = rotation.T
        inverse[:3, 3] = -rotation.T @ translation
        return inverse

    @property
    def centre(self) -> Array:
        """[3], the camera's centre in the world."""
        return self.world_from_cam[:3, 3]

    def pixel_centres(self) -> Array:
        """[H,W,2]: (u, v) of every pixel's centre, px."""
        u, v = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.stack([u, v], axis=-1)

    def rays(self, pixels: Array) -> tuple[Array, Array]:
        """Pixels [...,2] to (origin [3], directions [...,3]) in the world; directions have z = 1 in the camera, so t is depth."""
        xy = np.stack(
            [(pixels[..., 0] - self.K[0, 2]) / self.K[0, 0], (pixels[..., 1] - self.K[1, 2]) / self.K[1, 1]],
            axis=-1,
        )
        xy = self._undistort(xy)
        directions = np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1)
        return self.centre, directions @ self.cam_from_world[:3, :3]

    def project(self, points: Array) -> tuple[Array, Array]:
        """World points [...,3] to (pixels [...,2], depth [...]); pixels are meaningless where depth <= 0."""
        local = points @ self.cam_from_world[:3, :3].T + self.cam_from_world[:3, 3]
        depth = local[..., 2]
        safe = np.where(depth > 0, depth, 1.0)
        xy = self._distort(local[..., :2] / safe[..., None])
        return np.stack([xy[..., 0] * self.K[0, 0] + self.K[0, 2], xy[..., 1] * self.K[1, 1] + self.K[1, 2]], axis=-1), depth

    def _distort(self, xy: Array) -> Array:
        if self.fisheye:
            r = np.linalg.norm(xy, axis=-1, keepdims=True)
            return xy * self._bend(np.arctan(r)) / np.maximum(r, 1e-12)
        if not any(self.distortion):
            return xy
        k1, k2, p1, p2, k3, k4, k5, k6 = (*self.distortion, *[0.0] * (8 - len(self.distortion)))
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
        return np.stack(
            [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y],
            axis=-1,
        )

    def _undistort(self, distorted: Array) -> Array:
        """Inverse of `_distort` by fixed-point steps; 30 reach float64 precision for the mild lenses that tests use."""
        xy = distorted
        if self.fisheye:
            bent = np.linalg.norm(distorted, axis=-1, keepdims=True)
            angle = bent
            for _ in range(30):
                angle = bent - (self._bend(angle) - angle)
            return distorted * np.tan(angle) / np.maximum(bent, 1e-12)
        if any(self.distortion):
            for _ in range(30):
                xy = distorted - (self._distort(xy) - xy)
        return xy

    def _bend(self, angle: Array) -> Array:
        """Angle from the optical axis (radians) to distance from the principal point, in focal lengths."""
        return angle * (1 + sum(k * angle ** (2 * i + 2) for i, k in enumerate(self.distortion[:4])))


def look_at(eye: Array, target: Array, up: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> Array:
    """cam_from_world [4,4] of a camera at `eye` that looks at `target`, with `up` towards the top of its image."""
    forward = np.asarray(target, float) - np.asarray(eye, float)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, np.asarray(up, float))
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    cam_from_world = np.eye(4)
    cam_from_world[:3, :3] = rotation
    cam_from_world[:3, 3] = -rotation @ np.asarray(eye, float)
    return cam_from_world


def intrinsics(width: int, height: int, fov_degrees: float) -> Array:
    """K [3,3] with square pixels and a centred principal point; `fov_degrees` is the horizontal field of view."""
    focal = 0.5 * width / np.tan(0.5 * np.radians(fov_degrees))
    return np.array([[focal, 0.0, 0.5 * width], [0.0, focal, 0.5 * height], [0.0, 0.0, 1.0]])
