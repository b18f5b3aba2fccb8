"""What a CUDA graph of a training step reads of the views: one frame, whose content is replaced between replays."""

from __future__ import annotations

import torch
from torch import Tensor

from ....rasterizer import Camera
from ...losses.motion_terms import FLOW_SCALE
from ...views import Views


class OneView:
    """Stands for ``views`` at ``scale`` (flow: at `FLOW_SCALE` of that) while a step is captured; `show` fills in a frame. Everything is on
    the device of the views."""

    def __init__(self, views: Views, scale: float) -> None:
        self._views, self._scale = views, scale
        self.width, self.height, self.background = views.width, views.height, views.background
        self.load_alpha, self.load_kept = views.load_alpha, views.load_kept
        device = views.device
        width, height = views.size(scale)
        self._cameras = {
            size: Camera(torch.eye(3, device=device), torch.eye(4, device=device), *views.size(size), views.near)
            for size in (scale, scale * FLOW_SCALE)
        }
        self._moment = torch.zeros((), device=device)
        self._backdrop = views.backdrop().to(device)
        self._target = torch.zeros(height, width, 3, device=device)
        self._alpha = torch.zeros(height, width, device=device)
        small_width, small_height = views.size(scale * FLOW_SCALE)
        self._edges = torch.zeros(small_height, small_width, device=device)
        self._kept = torch.ones(height, width, dtype=torch.bool, device=device)

    def show(self, i: int, flow: bool) -> None:
        """Put in frame ``i``, with its edges if they are used for ``flow``. Does not wait for the device."""
        views, scale = self._views, self._scale
        for size, own in self._cameras.items():
            if flow or size == scale:
                camera = views.rasterizer_camera(i, size)
                own.K.copy_(camera.K, non_blocking=True)
                own.cam_from_world.copy_(camera.cam_from_world, non_blocking=True)
        if flow:
            self._edges.copy_(views.edges(i, scale * FLOW_SCALE))
        self._moment.fill_(views.moment(i))
        self._target.copy_(views.target(i, scale))
        if self.load_alpha is not None:
            self._alpha.copy_(views.alpha(i, scale))
        if self.load_kept is not None:
            kept = views.kept(i, scale)
            assert kept is not None
            self._kept.copy_(kept)

    # What a step asks of `Views`.

    def size(self, scale: float) -> tuple[int, int]:
        return self._views.size(scale)

    def window(self, i: int, scale: float = 1.0) -> None:
        """The whole image."""

    def rasterizer_camera(self, i: int, scale: float = 1.0, window: None = None) -> Camera:
        return self._cameras[scale]

    def moment(self, i: int) -> Tensor:
        return self._moment

    def backdrop(self) -> Tensor:
        return self._backdrop

    def target(self, i: int, scale: float = 1.0, window: None = None) -> Tensor:
        return self._target

    def alpha(self, i: int, scale: float = 1.0, window: None = None) -> Tensor:
        return self._alpha

    def edges(self, i: int, scale: float = 1.0) -> Tensor:
        return self._edges

    def kept(self, i: int, scale: float = 1.0, window: None = None) -> Tensor | None:
        return None if self.load_kept is None else self._kept
