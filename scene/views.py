"""The posed frames of a capture as training uses them: cameras as tensors, and images that are decoded once and cached within a budget, in
memory and on the training device."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from threading import RLock
from typing import Literal, NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

from ..rasterizer import Camera
from .edges import edge_weights
from .motion.times import corrected

CACHE_BYTES = 4 << 30
WINDOW_MARGIN = 0.04  # of the image's longer side, around the filled part
MOST_WINDOW = 0.8  # of the image's area; a larger window saves nothing

WHOLLY = 254 / 255  # value of a downscaled mask from which a pixel counts: all of its parts do

Window = tuple[int, int, int, int]
PictureKind = Literal["colour", "alpha", "kept", "edges"]


class Projected(NamedTuple):
    """point [n] int: indices of the points that a frame shows. x, y [n] int: the pixels that they fall in. depth [n]: world units along the
    optical axis."""

    point: np.ndarray
    x: np.ndarray
    y: np.ndarray
    depth: np.ndarray


@dataclass
class Views:
    """F posed frames.

    K [F,3,3] px and cam_from_world [F,4,4], float64; time [F] in [0,1]; camera [F] int; next [F] int, the next frame of the same camera,
    or -1; train [n] int, the training frames. ``load(i)`` returns uint8 [H,W,3], composited on the background. ``load_alpha(i)`` returns
    uint8 [H,W]; it is None if the capture has no alpha. ``load_kept(i)`` returns uint8 [H,W], 255 for pixels that count and 0 for those
    that do not; it is None if all count.
    ``load_moving(i)`` returns uint8 [H,W], 255 where something moves; it is None if that is unknown or if cameras move.
    recorder [F] int: frames with the same number record colours alike; the camera number if None.
    clocks: see `Model`. background [3] in [0,1]. near: world units. device: where images are needed; cameras are always on the CPU.
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
    load_alpha: Callable[[int], np.ndarray] | None = None
    load_kept: Callable[[int], np.ndarray] | None = None
    stored_edges: Callable[[int], np.ndarray] | None = None
    load_moving: Callable[[int], np.ndarray] | None = None
    recorder: np.ndarray | None = None
    clocks: Mapping[int, float] = field(default_factory=dict)
    device: str | torch.device = "cpu"
    _images: OrderedDict[tuple[int, float, PictureKind], np.ndarray] = field(default_factory=OrderedDict, repr=False)
    _windows: dict[int, tuple[int, int, int, int] | None] = field(default_factory=dict, repr=False)
    _bytes: int = 0
    _there: OrderedDict[tuple[int, float, PictureKind], Tensor] = field(
        default_factory=OrderedDict, repr=False
    )  # on `device`, unless that is the CPU
    _there_bytes: int = 0
    _lock: RLock = field(default_factory=RLock, repr=False)  # of all of these: seeds at several times are coloured at once

    def __post_init__(self) -> None:
        self.device = str(self.device)

    def moment(self, i: int) -> float:
        """Time of frame ``i`` in [0, 1], by what is known of its camera's clock."""
        return corrected(float(self.time[i]), int(self.camera[i]), self.clocks)

    def backdrop(self) -> Tensor:
        """`background` as a tensor [3] on the CPU."""
        return torch.tensor(self.background)

    def recorded_by(self, i: int) -> int:
        """Number shared by the frames with the same exposure and white balance as frame ``i``."""
        return int((self.camera if self.recorder is None else self.recorder)[i])

    def rasterizer_camera(self, i: int, scale: float = 1.0, window: Window | None = None) -> Camera:
        """Camera of frame ``i`` for an image resized by ``scale`` (1 = full size) and cropped to ``window`` if one is given."""
        width, height = self.size(scale)
        K = self.K[i].copy()
        K[0] *= width / self.width
        K[1] *= height / self.height
        if window is not None:
            left, top, right, bottom = window
            K[0, 2] -= left
            K[1, 2] -= top
            width, height = right - left, bottom - top
        return Camera(
            torch.tensor(K, dtype=torch.float32), torch.tensor(self.cam_from_world[i], dtype=torch.float32), width, height, self.near
        )

    def size(self, scale: float) -> tuple[int, int]:
        """Width and height in pixels at ``scale``."""
        return max(1, round(self.width * scale)), max(1, round(self.height * scale))

    def window(self, i: int, scale: float = 1.0) -> Window | None:
        """Left, top, right, bottom of the part of frame ``i`` that its alpha fills, with a margin, in px at ``scale``. None if that is most
        of the image or unknown, and on a GPU, which draws a whole image in about the same time."""
        if self.load_alpha is None or self.device != "cpu":
            return None
        if i not in self._windows:
            self._windows[i] = filled_window(self._image(i, 1.0, "alpha"))
        found = self._windows[i]
        if found is None:
            return None
        width, height = self.size(scale)
        x, y = width / self.width, height / self.height
        left, top, right, bottom = found
        return int(left * x), int(top * y), min(math.ceil(right * x), width), min(math.ceil(bottom * y), height)

    def target(self, i: int, scale: float = 1.0) -> Tensor:
        """Image [H, W, 3] float32 in [0, 1]."""
        return floats(self.stored(i, scale, "colour"))

    def kept(self, i: int, scale: float = 1.0) -> Tensor | None:
        """[H, W] bool, the pixels that count; None if all do."""
        return None if self.load_kept is None else floats(self.stored(i, scale, "kept")) >= WHOLLY

    def edges(self, i: int, scale: float = 1.0) -> Tensor:
        """[H, W] float32 in [0, 1], the weight of an edge at each pixel."""
        return floats(self.stored(i, scale, "edges"))

    def stored(self, i: int, scale: float, kind: PictureKind, window: Window | None = None) -> Tensor:
        """The picture of frame ``i`` of this kind as it is kept on `device`, uint8 [H, W, 3] or [H, W], cropped to ``window`` if one is
        given. It may be gone from there after the next call."""
        if window is not None:
            left, top, right, bottom = window
            return self.stored(i, scale, kind)[top:bottom, left:right]
        if self.device == "cpu":
            return torch.from_numpy(self._image(i, scale, kind))
        key = (int(i), scale, kind)
        with self._lock:
            if key not in self._there:
                self._there[key] = torch.from_numpy(self._image(i, scale, kind)).to(self.device)
                self._there_bytes += self._there[key].nbytes
            self._there.move_to_end(key)
            while self._there_bytes > CACHE_BYTES and len(self._there) > 1:
                self._there_bytes -= self._there.popitem(last=False)[1].nbytes
            return self._there[key]

    def _image(self, i: int, scale: float, kind: PictureKind = "colour") -> np.ndarray:
        key = (int(i), scale, kind)
        with self._lock:
            if key in self._images:
                self._images.move_to_end(key)
                return self._images[key]
        if scale == 1.0:
            edges = self.stored_edges or self._own_edges
            load = {"colour": self.load, "alpha": self.load_alpha, "kept": self.load_kept, "edges": edges}[kind]
            assert load is not None
            image = load(int(i))
        else:  # of the whole picture, which takes longer to decode than to keep
            image = cv2.resize(self._image(i, 1.0, kind), self.size(scale), interpolation=cv2.INTER_AREA)
        image = np.require(image, requirements=["C", "W"])  # torch does not accept read-only memory
        with self._lock:
            if key not in self._images:  # or another thread was faster
                self._images[key] = image
                self._bytes += image.nbytes
            while self._bytes > CACHE_BYTES and len(self._images) > 1:
                self._bytes -= self._images.popitem(last=False)[1].nbytes
            return image

    def _own_edges(self, i: int) -> np.ndarray:
        return edge_weights(self._image(i, 1.0))

    def project(self, i: int, points: np.ndarray) -> Projected:
        """Where frame ``i``, at full size, shows ``points`` [P, 3] (world units). The result has, in order, the points that are farther
        than ``near`` in front of the camera and inside the image; occlusion is ignored. Pixel (x, y) spans x to x + 1 and y to y + 1 px.
        """
        cam = points @ self.cam_from_world[i, :3, :3].T + self.cam_from_world[i, :3, 3]
        ahead = np.flatnonzero(cam[:, 2] > self.near)
        cam = cam[ahead]
        x, y = (np.floor(self.K[i, c, c] * cam[:, c] / cam[:, 2] + self.K[i, c, 2]) for c in (0, 1))
        inside = (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)
        return Projected(ahead[inside], x[inside].astype(int), y[inside].astype(int), cam[inside, 2])

    def lift(self, i: int, at: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """World positions [n, 3] of places ``at`` [n, 2] (x, y, px at full size) of frame ``i`` at ``depth`` [n]."""
        K, pose = self.K[i], self.cam_from_world[i]
        ray = np.concatenate([(at - K[:2, 2]) / K[[0, 1], [0, 1]], np.ones((len(at), 1))], axis=1)
        return (ray * depth[:, None] - pose[:3, 3]) @ pose[:3, :3]

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


def floats(picture: Tensor) -> Tensor:
    """A `Views.stored` picture as float32 in [0, 1]."""
    return picture.float().div_(255.0)


def filled_window(alpha: np.ndarray) -> Window | None:
    """Left, top, right, bottom of the part that ``alpha`` [H, W] uint8 fills, plus a margin; None if that is most of the image or empty."""
    rows, columns = np.flatnonzero(alpha.max(1) > 0), np.flatnonzero(alpha.max(0) > 0)
    height, width = alpha.shape
    if not len(rows):
        return None
    margin = round(WINDOW_MARGIN * max(height, width))
    left, right = max(int(columns[0]) - margin, 0), min(int(columns[-1]) + 1 + margin, width)
    top, bottom = max(int(rows[0]) - margin, 0), min(int(rows[-1]) + 1 + margin, height)
    return None if (right - left) * (bottom - top) > MOST_WINDOW * width * height else (left, top, right, bottom)


@torch.no_grad()
def inside_image(camera: Camera, points: Tensor, margin: float = 0.0) -> Tensor:
    """Which of ``points`` [N, 3] (world units) project into the image, widened on each side by ``margin`` of its size: [N] bool."""
    R, T = camera.cam_from_world[:3, :3], camera.cam_from_world[:3, 3]
    x, y, z = (points @ R.T.to(points, non_blocking=True) + T.to(points, non_blocking=True)).unbind(1)
    # Not as numbers, for which the host would wait if the camera is on a GPU.
    fx, fy, cx, cy = (camera.K[row, column] for row, column in ((0, 0), (1, 1), (0, 2), (1, 2)))
    depth = z.clamp(min=1e-6)
    px, py = fx * x / depth + cx, fy * y / depth + cy
    wide, high = margin * camera.width, margin * camera.height
    return (z > camera.near) & (px > -wide) & (px < camera.width + wide) & (py > -high) & (py < camera.height + high)
