"""The posed frames of a capture as training sees them: cameras as tensors, images decoded once and kept within a budget, in memory and
on the device that learns from them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

from ..rasterizer import Camera
from .edges import edge_weights

CACHE_BYTES = 4 << 30


class Projected(NamedTuple):
    """point [n] int: numbers of the points that a frame shows. x, y [n] int: the pixels that they lie in. depth [n]: world units along the
    optical axis."""

    point: np.ndarray
    x: np.ndarray
    y: np.ndarray
    depth: np.ndarray


@dataclass
class Views:
    """F posed frames.

    K [F,3,3] px and cam_from_world [F,4,4], float64; time [F] in [0,1]; camera [F] int; next [F] int, the same camera's frame at its
    next time or -1; train [n] int, the frames to learn from. ``load(i)`` returns uint8 [H,W,3], composited on the background.
    background [3] in [0,1]. near: world units. device: where pictures are wanted; cameras are always on the CPU.
    """

    K: np.ndarray
    cam_from_world: np.ndarray
    time: np.ndarray
    camera: np.ndarray
    next: np.ndarray
    train: np.ndarray
    width: int
    height: int
    load: Callable[[int], np.ndarray]
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    near: float = 0.01
    stored_edges: Callable[[int], np.ndarray] | None = None
    device: str | torch.device = "cpu"
    _images: OrderedDict[tuple[int, float], np.ndarray] = field(default_factory=OrderedDict, repr=False)
    _edges: dict[int, np.ndarray] = field(default_factory=dict, repr=False)
    _bytes: int = 0
    _there: OrderedDict[tuple[int, float], Tensor] = field(
        default_factory=OrderedDict, repr=False
    )  # on `device`, where that is not the CPU
    _there_bytes: int = 0

    def rasterizer_camera(self, i: int, scale: float = 1.0) -> Camera:
        """Camera of frame ``i``, its image resized by ``scale`` (1 = full size)."""
        width, height = self.size(scale)
        K = self.K[i].copy()
        K[0] *= width / self.width
        K[1] *= height / self.height
        return Camera(
            torch.tensor(K, dtype=torch.float32), torch.tensor(self.cam_from_world[i], dtype=torch.float32), width, height, self.near
        )

    def size(self, scale: float) -> tuple[int, int]:
        """Width and height in pixels at ``scale``."""
        return max(1, round(self.width * scale)), max(1, round(self.height * scale))

    def target(self, i: int, scale: float = 1.0) -> Tensor:
        """[H, W, 3] float32 in [0, 1]."""
        if self.device == "cpu":
            return torch.from_numpy(self._image(i, scale)).float().div_(255.0)
        key = (int(i), scale)
        if key not in self._there:
            self._there[key] = torch.from_numpy(self._image(i, scale)).to(self.device)
            self._there_bytes += self._there[key].nbytes
        self._there.move_to_end(key)
        while self._there_bytes > CACHE_BYTES and len(self._there) > 1:
            self._there_bytes -= self._there.popitem(last=False)[1].nbytes
        return self._there[key].float().div_(255.0)

    def edges(self, i: int, scale: float = 1.0) -> Tensor:
        """[H, W] float32 in [0, 1], the weight of an edge at each pixel."""
        if i not in self._edges:
            self._edges[i] = self.stored_edges(i) if self.stored_edges is not None else edge_weights(self._image(i, 1.0))
        edges = self._edges[i]
        if scale != 1.0:
            edges = cv2.resize(edges, self.size(scale), interpolation=cv2.INTER_AREA)
        return torch.from_numpy(edges).to(self.device).float().div_(255.0)

    def _image(self, i: int, scale: float) -> np.ndarray:
        key = (int(i), scale)
        if key in self._images:
            self._images.move_to_end(key)
            return self._images[key]
        image = self.load(int(i))
        if scale != 1.0:
            image = cv2.resize(image, self.size(scale), interpolation=cv2.INTER_AREA)
        self._images[key] = np.ascontiguousarray(image)
        self._bytes += image.nbytes
        while self._bytes > CACHE_BYTES and len(self._images) > 1:
            self._bytes -= self._images.popitem(last=False)[1].nbytes
        return self._images[key]

    def project(self, i: int, points: np.ndarray) -> Projected:
        """Where frame ``i``, at full size, shows ``points`` [P, 3] (world units): those that lie further ahead than ``near`` and inside the
        picture, in their order. Pixel (x, y) reaches from x to x + 1 and y to y + 1 px. Whether something else hides them is not asked.
        """
        cam = points @ self.cam_from_world[i, :3, :3].T + self.cam_from_world[i, :3, 3]
        ahead = np.flatnonzero(cam[:, 2] > self.near)
        cam = cam[ahead]
        x, y = (np.floor(self.K[i, c, c] * cam[:, c] / cam[:, 2] + self.K[i, c, 2]) for c in (0, 1))
        inside = (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)
        return Projected(ahead[inside], x[inside].astype(int), y[inside].astype(int), cam[inside, 2])

    def centres(self) -> np.ndarray:
        """Camera centres [F, 3] in world units, -R^T t."""
        R, T = self.cam_from_world[:, :3, :3], self.cam_from_world[:, :3, 3]
        return -np.einsum("fji,fj->fi", R, T)

    def viewing_distance(self, points: np.ndarray) -> float:
        """Median distance from the training cameras to ``points`` [P, 3]: the scene's unit of length for learning rates."""
        centres = self.centres()[self.train]
        sample = points[:: max(1, len(points) // 2000)]
        distance = np.median(np.linalg.norm(sample[None] - centres[:: max(1, len(centres) // 50), None], axis=2))
        return float(max(distance, 1e-6))
