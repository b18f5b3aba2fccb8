"""What a CUDA graph of a training step reads of the views: one frame, whose content is replaced between replays."""

from __future__ import annotations

import torch
from torch import Tensor

from ....rasterizer import Camera
from ...losses.motion_terms import FLOW_SCALE
from ...views import WHOLLY, Kind, Views

K_SIZE, POSE_SIZE = 9, 16


class OneView:
    """Stands for ``views`` at ``scale`` (flow: at `FLOW_SCALE` of that) while a step is captured; `show` fills in a frame. Everything is on
    the device of the views."""

    def __init__(self, views: Views, scale: float) -> None:
        self._views, self._scale = views, scale
        self.width, self.height, self.background = views.width, views.height, views.background
        self.load_alpha, self.load_kept = views.load_alpha, views.load_kept
        device, sizes = views.device, (scale, scale * FLOW_SCALE)
        # Both cameras and the time travel in one copy.
        self._numbers = torch.zeros(2 * (K_SIZE + POSE_SIZE) + 1, device=device)
        *parts, self._moment = self._numbers.split([K_SIZE, POSE_SIZE, K_SIZE, POSE_SIZE, 1])
        self._cameras = {
            size: Camera(K.view(3, 3), pose.view(4, 4), *views.size(size), views.near)
            for size, K, pose in zip(sizes, parts[::2], parts[1::2])
        }
        self._known: dict[int, Tensor] = {}  # the numbers of each frame, on the CPU
        self._backdrop = views.backdrop().to(device)
        kinds: dict[Kind, object] = {"colour": True, "alpha": views.load_alpha, "kept": views.load_kept}
        (width, height), (small_width, small_height) = map(views.size, sizes)
        self._pictures = {
            kind: torch.zeros((height, width, 3) if kind == "colour" else (height, width), dtype=torch.uint8, device=device)
            for kind, there in kinds.items()
            if there
        }
        self._edges = torch.zeros(small_height, small_width, device=device)

    def show(self, i: int, flow: bool) -> None:
        """Put in frame ``i``, with its edges if they are used for ``flow``. Does not wait for the device, once it has the pictures."""
        views = self._views
        if i not in self._known:
            cameras = [views.rasterizer_camera(i, size) for size in self._cameras]
            numbers = [part.flatten() for camera in cameras for part in (camera.K, camera.cam_from_world)]
            self._known[i] = torch.cat([*numbers, torch.tensor([views.moment(i)])])
        self._numbers.copy_(self._known[i], non_blocking=True)
        for kind, picture in self._pictures.items():
            picture.copy_(views.stored(i, self._scale, kind))
        if flow:
            self._edges.copy_(views.edges(i, self._scale * FLOW_SCALE))

    # What a step asks of `Views`.

    def size(self, scale: float) -> tuple[int, int]:
        return self._views.size(scale)

    def window(self, i: int, scale: float = 1.0) -> None:
        """The whole image."""

    def rasterizer_camera(self, i: int, scale: float = 1.0, window: None = None) -> Camera:
        return self._cameras[scale]

    def moment(self, i: int) -> Tensor:
        return self._moment[0]

    def backdrop(self) -> Tensor:
        return self._backdrop

    def target(self, i: int, scale: float = 1.0, window: None = None) -> Tensor:
        return self._pictures["colour"].float().div_(255.0)

    def alpha(self, i: int, scale: float = 1.0, window: None = None) -> Tensor:
        return self._pictures["alpha"].float().div_(255.0)

    def kept(self, i: int, scale: float = 1.0, window: None = None) -> Tensor | None:
        return None if self.load_kept is None else self._pictures["kept"].float().div_(255.0) >= WHOLLY

    def edges(self, i: int, scale: float = 1.0) -> Tensor:
        return self._edges
